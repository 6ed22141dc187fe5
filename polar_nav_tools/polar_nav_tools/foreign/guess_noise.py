"""The part of a guessed mapping that no data show: the instruments, and their noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from polar_nav_ros.adapters.noise_classes import (
    DVL_CLASSES,
    IMU_CLASSES,
    assumed_sound_speed,
    common_noise,
    dvl_noise,
    imu_noise,
    unit_of,
)

from .instrument_noise import source_of
from .lines import Lines


@dataclass(frozen=True)
class Choices:
    """What a person knows of a recording; None where nobody said.

    Attributes
    ----------
    imu, dvl : str or None
        Classes of instruments, of `IMU_CLASSES` and `DVL_CLASSES`.
    reference : str or None
        ``bottom`` or ``water``: what the velocity of the DVL is relative to.
    clock : str or None
        ``header`` or ``log``: whose times are those of validity.
    vehicle : str or None
        Namespace that the IMU is in, where several have one.
    """

    imu: str | None = None
    dvl: str | None = None
    reference: str | None = None
    clock: str | None = None
    vehicle: str | None = None


def put_noise(out: Lines, choices: Choices, *, has_dvl: bool) -> None:
    """Write the section ``noise``: numbers of the classes that are known, FILL IN for the others.

    Parameters
    ----------
    out : Lines
    choices : Choices
    has_dvl : bool
        Whether the mapping has one.
    """
    out.say('Noise: of the class of each instrument, sources in polar_nav_sim/sensors; numbers')
    out.say('of its own data sheet or Allan deviation are better (docs/parameters.md).')
    out.put('noise:')
    _instrument(out, 'imu', choices.imu, IMU_CLASSES)
    if choices.imu is not None:
        _numbers(out, imu_noise(choices.imu))
    if has_dvl:
        _instrument(out, 'dvl', choices.dvl, DVL_CLASSES)
        if choices.dvl is not None:
            _sound_speed(out, choices.dvl)
            _numbers(out, dvl_noise(choices.dvl, water=choices.reference == 'water'))
    out.say('errors that all fixes, or all depths, have in common: nobody stated them, these', 2)
    out.say('are the defaults of the engine', 2)
    _numbers(out, common_noise())
    out.put()


def _sound_speed(out: Lines, name: str) -> None:
    """Write that a DVL which assumes a sound speed can be corrected."""
    speed = assumed_sound_speed(name)
    if speed > 0.0:
        out.say(f'it assumes a sound speed ({speed:g} m/s unless set): long by 4 % in polar', 2)
        out.say('water, 3 % of it stand in dvl_scale_sigma. To correct it state `sound_speed:`', 2)
        out.say(f'{speed:g} in dvl and `water_sound_speed:` (1440?) in parameters; then', 2)
        corrected = dvl_noise(name, corrected=True)['dvl_scale_sigma']
        out.say(f'dvl_scale_sigma is {_number(corrected)}', 2)


def _instrument(out: Lines, role: str, name: str | None, classes: tuple[str, ...]) -> None:
    if name is None:
        out.say(
            f'FILL IN which {role.upper()} it was: the data cannot tell, and the noise of a', 2
        )
        out.say(
            f'better one makes the filter refuse good data. Its class, or `polar map --{role}', 2
        )
        out.say('CLASS` for the numbers:', 2)
        out.say(f'  {", ".join(classes)}', 2)
        out.put(f'{role}: FILL_IN', 2)
        return
    out.say(f'{source_of(role, name)}', 2)
    out.put(f'{role}: {name}', 2)


def _numbers(out: Lines, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        unit = unit_of(name)
        out.put(f'{name}: {_number(value)}{f"    # {unit}" if unit else ""}', 2)


def _number(value: float) -> str:
    """Three digits that YAML reads as a number: a mantissa with a point, before an exponent."""
    mantissa, e, exponent = f'{value:.3g}'.partition('e')
    return f'{mantissa}{"" if "." in mantissa or not e else ".0"}{e}{exponent}'
