"""Certificates of replays: hashes of results with bag, parameters and machine, and their check.

A certificate is a small JSON file. It is written of a bag whose replay gave the recorded bytes,
and names all that those depend on: the bag, the parameters, the packages, the processor. Who
checks it with the same packages on the same model of processor must get the same bytes. Anywhere
else the recorded estimates, which the certificate vouches for, are what a replay is compared with.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from polar_nav_core.engine.version import ENGINE_VERSION, engine_version_of
from polar_nav_core.errors import PolarNavError
from polar_nav_core.params import to_mapping
from polar_nav_core.user_files import read_text, writing

from ..bags.reader import Bag
from ..live.run_info import cpu_identity, git_commit, lock_sha256, versions
from ..series.closeness import LIMIT_SIGMA, Closeness
from .by_message import ReplayResult
from .comparison import compare
from .described import read_parameters
from .recorded import RecordedInputs
from .verification import VerifyResult

FORMAT = 'polar_nav certificate'
VERSION = 1
_BLOCK = 1 << 20
_SOURCES = Path(__file__).resolve().parents[3]


class CertificateError(PolarNavError):
    """A certificate that cannot be read, or a replay that cannot be certified."""


@dataclass(frozen=True)
class Certificate:
    """Hashes of a replay's results, with its bag, parameters, versions and machine.

    Attributes
    ----------
    vehicle : str
        The follower.
    bag_sha256 : str
        Over the contents of the MCAP files, in order.
    parameters : dict
        All parameters of the follower, and their hash.
    outputs : dict
        Topic -> 'sha256' over the messages in order, and 'messages'.
    machine : dict
        engine_version, cpu, python, requirements_lock_sha256, versions: bytes depend on these.
    run : dict
        mission, seed, configuration, git_commit: for people.
    """

    vehicle: str
    bag_sha256: str
    parameters: dict[str, Any]
    parameters_sha256: str
    outputs: dict[str, dict[str, Any]]
    machine: dict[str, Any]
    run: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {'format': FORMAT, 'version': VERSION, **asdict(self)}

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        with writing(path):
            path.write_text(json.dumps(self.to_dict(), indent=1) + '\n', encoding='utf-8')


@dataclass(frozen=True)
class Check:
    """Result of a certificate's check.

    Attributes
    ----------
    same_place : bool
        Same packages and same model of processor: bits must be equal.
    failures : tuple of str
        What is wrong, one sentence each.
    notes : tuple of str
        What is different here and may be.
    closeness : Closeness or None
        Largest difference of the estimates, where bits need not be equal.
    """

    same_place: bool
    failures: tuple[str, ...]
    notes: tuple[str, ...] = ()
    closeness: Closeness | None = field(default=None)

    @property
    def ok(self) -> bool:
        """Whether the certificate holds."""
        return not self.failures

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'ok': self.ok,
            'same_place': self.same_place,
            'failures': list(self.failures),
            'notes': list(self.notes),
            'largest_difference': None if self.closeness is None else self.closeness.to_dict(),
            'limit_sigma': LIMIT_SIGMA,
        }


def certify(inputs: RecordedInputs, replayed: ReplayResult, result: VerifyResult) -> Certificate:
    """Certificate of the replay of a bag.

    Raises
    ------
    CertificateError
        When the bag is not whole, or its replay differs from what was recorded.
    """
    bag = inputs.bag
    if bag.problems:
        raise CertificateError(f'{bag.path} is not whole and gets no certificate')
    if not result.equal:
        why = (
            f'live and replay differ: {result.difference}'
            if result.comparison is None
            else f'it was recorded with engine {result.engine_version}, and engine '
            f'{ENGINE_VERSION} gives other bits'
        )
        raise CertificateError(f'{bag.path} gets no certificate: {why}')
    params = to_mapping(replayed.params)
    info = bag.run_info
    return Certificate(
        vehicle=inputs.vehicle,
        bag_sha256=bag_sha256(bag),
        parameters=params,
        parameters_sha256=parameters_sha256(params),
        outputs={
            topic: {'sha256': digest, 'messages': result.counts[topic][1]}
            for topic, digest in result.replay_sha256.items()
        },
        machine=_machine(),
        run={
            'mission': info.get('mission', ''),
            'seed': info.get('seed'),
            'configuration': replayed.params.configuration,
            'git_commit': git_commit(_SOURCES),
        },
    )


def check(
    certificate: Certificate, inputs: RecordedInputs, replayed: ReplayResult, result: VerifyResult
) -> Check:
    """Failures and notes of a replay compared with a certificate."""
    failures, notes = [], []
    if bag_sha256(inputs.bag) != certificate.bag_sha256:
        failures.append(f'{inputs.bag.path} is not the bag that the certificate is of')
    if inputs.vehicle != certificate.vehicle:
        failures.append(
            f'the certificate is of vehicle {certificate.vehicle}, not {inputs.vehicle}'
        )
    certified = read_parameters(certificate.parameters, inputs.engine_version).params
    failures += _other_parameters(certified, to_mapping(replayed.params))
    if parameters_sha256(certificate.parameters) != certificate.parameters_sha256:
        failures.append('the parameters in the certificate do not have the hash it states')
    for topic, stated in certificate.outputs.items():
        if result.live_sha256.get(topic) != stated['sha256']:
            failures.append(f'{topic}: the recorded messages do not have the certified hash')
    here = _machine()
    elsewhere = _other_place(certificate.machine, here)
    if elsewhere:
        notes += elsewhere
        if result.equal:
            notes.append('the bits are equal all the same')
    found: Closeness | None = None
    if not elsewhere:
        for topic, stated in certificate.outputs.items():
            if result.replay_sha256.get(topic) != stated['sha256']:
                failures.append(f'{topic}: the replay does not give the certified bytes')
        if result.difference is not None:
            failures.append(f'first difference: {result.difference}')
    if elsewhere or not result.equal:
        comparison = compare(inputs, replayed)
        found = comparison.closeness
        failures += comparison.problems() if elsewhere else comparison.failures
    return Check(not elsewhere, tuple(failures), tuple(notes), found)


def read_certificate(path: Path) -> Certificate:
    """Read a certificate.

    Raises
    ------
    CertificateError
        For a file that is none, or of a version that is not known here.
    ConfigError
        For a file that is not there, or no text.
    """
    text = read_text(path)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CertificateError(f'{path}: not a certificate: {error}') from error
    if not isinstance(content, dict) or content.get('format') != FORMAT:
        raise CertificateError(f'{path}: not a certificate: format is not {FORMAT!r}')
    if content.get('version') != VERSION:
        raise CertificateError(
            f'{path}: a certificate of version {content.get("version")!r}; {VERSION} is known here'
        )
    names = Certificate.__dataclass_fields__
    missing = sorted(n for n in names if n not in content)
    if missing:
        raise CertificateError(f'{path}: the certificate lacks {", ".join(missing)}')
    wrong = sorted(n for n in ('parameters', 'outputs', 'machine') if not _is_map(content[n]))
    wrong += [t for t, s in content['outputs'].items() if not _is_map(s)] if not wrong else []
    if wrong or any('sha256' not in stated for stated in content['outputs'].values()):
        raise CertificateError(
            f'{path}: the certificate is damaged: {", ".join(wrong) or "outputs"}'
        )
    return Certificate(**{n: content[n] for n in names})


def bag_sha256(bag: Bag) -> str:
    """Hash over the contents of a bag's files, in order."""
    h = hashlib.sha256()
    for file in bag.files:
        with file.path.open('rb') as stream:
            while block := stream.read(_BLOCK):
                h.update(block)
    return h.hexdigest()


def parameters_sha256(parameters: Mapping[str, Any]) -> str:
    """Hash over parameters, whatever their order."""
    return hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()


def _machine() -> dict[str, Any]:
    return {
        'engine_version': ENGINE_VERSION,
        'cpu': cpu_identity(),
        'python': platform.python_version(),
        'requirements_lock_sha256': lock_sha256(),
        'versions': versions(),
    }


def _other_place(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """Sentences about differences of machine and versions that bits depend on."""
    out = []
    if (certified_with := engine_version_of(there)) != ENGINE_VERSION:
        out.append(f'engine: certified with {certified_with}, here {ENGINE_VERSION}')
    out += [
        f'{what}: certified with {there.get(key) or "none"}, here {here[key] or "none"}'
        for key, what in (('cpu', 'processor'), ('python', 'Python'))
        if there.get(key) != here[key]
    ]
    if not here['requirements_lock_sha256'] or (
        there.get('requirements_lock_sha256') != here['requirements_lock_sha256']
    ):
        out.append('requirements.lock: not the one it was certified with')
    certified = there.get('versions')
    for name, version in here['versions'].items():
        known = certified.get(name) if isinstance(certified, dict) else None
        if known != version:
            out.append(f'{name}: certified with {known}, here {version}')
    return out


def _other_parameters(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    there, here = json.loads(json.dumps(there)), json.loads(json.dumps(here))
    return [
        f'parameter {name}: certified {there.get(name, "unknown")!r}, '
        f'here {here.get(name, "unknown")!r}'
        for name in sorted({*there, *here})
        if name not in there or name not in here or there[name] != here[name]
    ]


def _is_map(value: Any) -> bool:  # noqa: ANN401 - anything that JSON holds
    return isinstance(value, dict)
