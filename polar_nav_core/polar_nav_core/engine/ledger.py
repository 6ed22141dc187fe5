"""Record of position fixes: duplicates, counts, verdicts that change, receipts."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from enum import Enum

from ..arrays import Array
from ..kernels.sins.update import Ints
from .disagreement import RefusedRow
from .events import Fix
from .fix_record import FixRecord
from .followed import leaps
from .health.conditions import Condition, Culprit, Level
from .health.heading import LostHeading
from .integrity import IntegrityMonitor
from .level import levelled
from .outputs import Receipt
from .params import EngineParams
from .receipts import FusedFixes, age_s, decided_receipt, refused_verdict
from .refusals import unusable_fix
from .results import FixResult
from .sender_clock import SenderClock
from .verdicts import Refusal, Verdict

_FUSED_KEPT = 1 << 18
"""Fixes that were fused: those of the 4.97 days after which times in packets wrap, at one per
1.6 s. Each takes 24 bytes."""
_REFUSED_KEPT = 4096
"""Fixes that the gate refused: they are apart, so that a flood of them drops no fused one."""
_SUSPICION_NS = 60_000_000_000
_SUSPICIOUS = {
    Verdict.NOT_FINITE: 'with numbers that no instrument states',
    Verdict.REPLAYED: 'with the content of earlier ones: somebody repeats them',
    Verdict.IMPLAUSIBLE: 'at places that the vehicle cannot have reached: displaced or forged',
}
"""Verdicts on packets that are reported, each with the end of its sentence."""
_FIX = 'fix'
_SPLIT = 3
"""Packets in a minute that contradict earlier ones: one or two are chance."""


class Believed(Enum):
    """What of an estimate refused fixes have replaced."""

    TURNED = 'a heading'
    ANEW = 'all but the biases'


def _replaced_by_fixes(since_s: float, how: Believed) -> Condition:
    """The condition that refused fixes have replaced a part of the estimate lately."""
    if how is Believed.TURNED:
        why = (
            'turned against dead reckoning: '
            'heading, gyro bias and DVL scale count as known no better than at the start'
        )
        culprit = Culprit.HEADING | Culprit.IMU | Culprit.FIXES
    else:
        why = (
            'and no correction led the estimate back to them: '
            'it began anew there, with an attitude from the accelerometers'
        )
        culprit = Culprit.IMU
    sentence = f'fixes were refused until {since_s:.0f} s ago, {why}'
    return Condition('fixes reopened', Level.ERROR, culprit, sentence)


class FixLedger:
    """Record of one vehicle's fixes.

    Parameters
    ----------
    params : EngineParams
    verdicts, fused : Counter
        The engine's counts, which are kept up here for what is decided here.
    """

    def __init__(
        self, params: EngineParams, verdicts: Counter[Verdict], fused: Counter[str]
    ) -> None:
        self._params = params
        self._configuration = params.resolved()
        self._max_delay_ns = round(params.max_delay_s * 1e9)
        self._verdicts = verdicts
        self._fused = fused
        self._of_fused = FixRecord(_FUSED_KEPT)
        self._of_refused = FixRecord(_REFUSED_KEPT)
        self._suspicious: dict[Verdict, tuple[deque[int], str]] = {
            verdict: (deque(maxlen=_REFUSED_KEPT), words) for verdict, words in _SUSPICIOUS.items()
        }
        self._split: deque[int] = deque(maxlen=_REFUSED_KEPT)
        self._too_sure: tuple[int, float] | None = None
        self._revisions: dict[tuple[int, int], int] = {}
        self._last_validity_ns = 0
        self._newest_used: Fix | None = None
        self._fused_before = 0
        self.received = 0
        self.integrity = IntegrityMonitor(params.max_gated_s, params.max_delay_s)
        self.refused_row = RefusedRow()
        self._clock = SenderClock()
        self._replaced: tuple[int, Believed] | None = None
        self.lost_heading: LostHeading | None = None
        """Heading with which all but the biases was last replaced, if no heading was since."""

    def start_anew(self) -> None:
        """Reset the agreement of fixes with the estimate, after a reset of the filter."""
        self.integrity = IntegrityMonitor(self._params.max_gated_s, self._params.max_delay_s)
        self.refused_row.clear()
        self._newest_used = self._replaced = self.lost_heading = None
        self._fused_before = self._fused[_FIX]

    def believed(
        self, stamp_ns: int, moved_m: float = 0.0, *, how: Believed | None = None
    ) -> None:
        """Note that fixes are believed again from a stamp [ns] on: those before count no more.

        ``moved_m`` is how far a start was off [m]; ``how``: what of the estimate they replaced.
        """
        self.integrity.believed(stamp_ns, moved_m)
        self.refused_row.clear()
        if how is not None:
            self._replaced = stamp_ns, how
            anew = how is Believed.ANEW
            self.lost_heading = LostHeading(stamp_ns, stamp_ns) if anew else None

    def packed(self) -> tuple[bytes, bytes]:
        """Fused and refused fixes as bytes, for `restore`."""
        return self._of_fused.pack(), self._of_refused.pack()

    def restore(
        self,
        fixes: tuple[int, int, int],
        records: tuple[bytes, bytes],
        since_start: int | None = None,
        lost_heading: LostHeading | None = None,
        followed: tuple[float, float, bool] | None = None,
    ) -> None:
        """Replace counts and fixes by those of an earlier ledger, and its doubt of the heading.

        ``since_start`` of the fused ones came after its start or reset; None: all.

        Raises
        ------
        ValueError
            For records that are none; nothing is changed then.
        """
        fused, refused = FixRecord(_FUSED_KEPT), FixRecord(_REFUSED_KEPT)
        fused.unpack(records[0])
        refused.unpack(records[1])
        self._of_fused, self._of_refused = fused, refused
        self.lost_heading = lost_heading
        if followed is not None:
            self.integrity.followed.restore(followed)
        self._revisions.clear()
        self.received, self._fused[_FIX], self._last_validity_ns = fixes
        self._fused_before = 0 if since_start is None else max(0, fixes[1] - since_start)
        if self._fused[_FIX]:
            self.integrity.known(self._last_validity_ns)

    def conditions(self, stamp_ns: int) -> list[Condition]:
        """Packets that nobody honest sends, and fixes believed again, in the minute before."""
        found = self._clock.conditions(stamp_ns)
        for verdict, (times, words) in self._suspicious.items():
            while times and times[0] < stamp_ns - _SUSPICION_NS:
                times.popleft()
            if times:
                key = f'packets {verdict.name}'
                sentence = f'{len(times)} packets in a minute {words}'
                found.append(Condition(key, Level.WARN, Culprit.FIXES, sentence))
        found += self._two_senders(stamp_ns)
        if self._too_sure is not None and stamp_ns < self._too_sure[0] + _SUSPICION_NS:
            sentence = (
                f'fixes state less noise than {self._too_sure[1]:g} m, the best of their kind '
                '(min_fix_sigma): that is used'
            )
            found.append(Condition('fixes too sure', Level.WARN, Culprit.FIXES, sentence))
        if self._replaced is not None:
            since_s = (stamp_ns - self._replaced[0]) * 1e-9
            if since_s < _SUSPICION_NS * 1e-9:
                found.append(_replaced_by_fixes(since_s, self._replaced[1]))
        return found

    def _two_senders(self, stamp_ns: int) -> list[Condition]:
        """The condition that packets come in two versions, of which the first is used."""
        times = self._split
        while times and times[0] < stamp_ns - _SUSPICION_NS:
            times.popleft()
        if len(times) < _SPLIT:
            return []
        sentence = (
            f'{len(times)} packets in a minute have number and time of a fix that was used, and '
            'another content: one of the two is false, and nothing shows which'
        )
        return [Condition('packets contradict', Level.ERROR, Culprit.FIXES, sentence)]

    def came(self, fix: Fix, *, wanted: bool = True) -> None:
        """Count a fix that was received; one that is not ``wanted`` was switched off."""
        self.received += 1
        if wanted:
            self.integrity.unused.came(fix.receive_ns)

    def refused(self, fix: Fix, verdict: Verdict, stated_ns: int) -> None:
        """Note the verdict on a fix that no state can use; ``stated_ns`` as of `refusal`."""
        if verdict is Verdict.DUPLICATE and self._of_fused.contradicts(fix, stated_ns):
            self._split.append(fix.receive_ns)
        self.suspect(verdict, fix.receive_ns)
        self._clock.refused(verdict, age_s(fix), fix.receive_ns)

    def suspect(self, verdict: Verdict, stamp_ns: int) -> None:
        """Note the verdict on a fix that was refused at a stamp [ns], where it is suspicious."""
        if verdict in self._suspicious:
            self._suspicious[verdict][0].append(stamp_ns)

    def too_sure(self, stamp_ns: int, sigma: float) -> None:
        """Note that a fix received at a stamp [ns] states less than ``sigma`` [m], of the best."""
        self._too_sure = stamp_ns, sigma

    def counts(self) -> tuple[int, int, int]:
        """Number of fixes received, of fixes fused, and newest validity of a fused one [ns]."""
        return self.received, self._fused[_FIX], self._last_validity_ns

    @property
    def fused_since_start(self) -> int:
        """Number of fixes that the navigation has used since it started or was reset.

        Only these have shown anything of where it started. A saved state brings its own along.
        """
        return self._fused[_FIX] - self._fused_before

    def refusal(self, fix: Fix, stated_ns: int) -> Refusal | None:
        """Verdict and reason if a fix cannot be used in any state; None if it can.

        ``stated_ns`` is the time of validity in its packet [ns].
        """
        unusable = unusable_fix(self._params, fix)
        if unusable is not None:
            return unusable
        if fix.validity_ns > fix.receive_ns:
            return Verdict.FROM_FUTURE, f'valid {-age_s(fix):.3f} s after it was received'
        copied = self._of_fused.copy_of(fix, stated_ns, numbers=True) or self._of_refused.copy_of(
            fix, stated_ns, numbers=False
        )
        if copied is Verdict.DUPLICATE:
            came = f'fix {fix.sequence} of {fix.source} came before'
            if self._of_fused.contradicts(fix, stated_ns):
                came += ', with another content'
            return copied, came
        if copied is not None:
            return copied, f'fix {fix.sequence} of {fix.source} has the content of an earlier one'
        if fix.receive_ns - fix.validity_ns > self._max_delay_ns:
            return (
                Verdict.TOO_OLD,
                f'{age_s(fix):.2f} s old, max_delay_s is {self._params.max_delay_s:.2f} s',
            )
        return None

    def remember(self, fix: Fix, stated_ns: int, *, fused: bool) -> None:
        """Store a fix that was decided on, by the time of validity in its packet [ns].

        Later copies of it are refused. The number of one that was not fused stays free.
        """
        (self._of_fused if fused else self._of_refused).add(fix, stated_ns)

    def decided(self, fix: Fix, cause: Fix, result: FixResult, now_ns: int) -> Receipt:
        """Receipt of a fix after the gate's decision; ``cause`` is the fix that led to it."""
        outcome, revision = result.outcome, 0
        offset_G = levelled(-outcome.z, fix)
        self._clock.usable(age_s(cause))
        if fix is not cause:
            revision = self._revised(fix)
            before = refused_verdict(outcome) if outcome.fused else Verdict.FUSED
            self._verdicts[before] -= 1
        if outcome.fused:
            # A station's fixes are meant to be believed at last: its watchdog says so.
            asked_G = None if self._params.mode == 'station' else offset_G
            self.integrity.fused(fix.validity_ns, cause.receive_ns, asked_G)
            self.refused_row.clear()
            self._fused[_FIX] += 1
            self._use(fix)
        else:
            used, farthest = self._newest_used, self._params.max_speed
            leapt = used is not None and fix.polar is None and leaps(used, fix, farthest)
            if self.integrity.gated(fix.validity_ns, cause.receive_ns, offset_G, leaps=leapt):
                self.refused_row.add(fix, offset_G)
            self.suspect(refused_verdict(outcome), cause.receive_ns)
            self._fused[_FIX] -= revision > 0
        return decided_receipt(fix, cause, result, now_ns, revision, self._configuration)

    def _use(self, fix: Fix) -> None:
        """Note a fix that was fused."""
        if fix.validity_ns >= self._last_validity_ns:
            self._last_validity_ns, self._newest_used = fix.validity_ns, fix

    def _revised(self, fix: Fix) -> int:
        """Number of the revision of a fix that was decided anew, from 1."""
        name = (fix.validity_ns, fix.sequence)
        number = self._revisions.pop(name, 0) + 1
        self._revisions[name] = number  # the newest stands last
        if len(self._revisions) > _REFUSED_KEPT:
            del self._revisions[next(iter(self._revisions))]
        return number

    def fused(self, fixes: Sequence[Fix], outcomes: Array, notes: Ints) -> FusedFixes:
        """What the receipts of consecutive fixes are made of that were all fused.

        None was refused before them since the newest that was fused.
        """
        newest = max(fixes, key=lambda fix: fix.validity_ns)
        self.received += len(fixes)
        self._fused[_FIX] += len(fixes)
        self._verdicts[Verdict.FUSED] += len(fixes)
        self._use(newest)
        self._clock.usable(age_s(fixes[-1]))
        self.integrity.fused(newest.validity_ns, fixes[-1].receive_ns)
        self.refused_row.clear()
        for fix in fixes:
            self.remember(fix, fix.validity_ns, fused=True)
        return FusedFixes(fixes, outcomes, notes, self._configuration)
