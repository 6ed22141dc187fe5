"""The rules of `engine.imu_sequence` as they were first written: to compare with."""

import numpy as np

from polar_nav_core.engine import imu_sequence
from polar_nav_core.engine.verdicts import Verdict


class Instrument:
    """Judges the values of an instrument by those before them.

    Parameters
    ----------
    most_repeats : int
        Equal values in a row that an axis may have; 0 judges nothing.
    """

    def __init__(self, most_repeats):
        self._most = most_repeats
        self._values = None
        self._runs = [0, 0, 0]
        self._lively = 0
        self._hung = False

    def hangs(self, values):
        """Return how often it has repeated itself, if that shows that it hangs; else 0.

        The three values are those of the next sample.
        """
        before, self._values = self._values, values
        if before is None or not self._most:
            return 0
        (x, y, z), (u, v, w) = values, before
        same = [x == u, y == v, z == w]
        if not any(same):  # nearly always
            self._runs, self._hung = [0, 0, 0], False
            self._lively += 1
            return 0
        return self._repeats(same)

    def _repeats(self, same):
        """`hangs` of a sample with axes that are as before."""
        hung = self._hung and not all(same)
        # An axis that says by chance what it had hung at has not done so since long.
        runs = [
            (1 if hung else run + 1) if one else 0
            for run, one in zip(self._runs, same, strict=True)
        ]
        self._runs, repeats = runs, min(runs)
        self._hung = repeats > self._most and self._lively >= imu_sequence.LIVELY
        if self._hung:
            return repeats
        if repeats > self._most or (not repeats and max(runs) > self._most):
            self._lively = 0
        else:
            self._lively += 1
        return 0


class SlowSequence:
    """Judges IMU samples by those before them.

    Parameters
    ----------
    params : EngineParams
    """

    def __init__(self, params):
        sins = params.mode == 'sins'
        self._most_repeats = params.max_imu_repeats if sins else 0
        self._most_leap = params.max_rate_leap if sins else np.inf
        most_alone = params.max_instrument_repeats if sins else 0
        self._gyros, self._accelerometers = Instrument(most_alone), Instrument(most_alone)
        self._values = None
        self._repeats = 0
        self._used = None
        self._odd = None

    def refusal(self, stamp_ns, omega_ib_b, f_b):
        """Verdict and reason of a sample that those before it refute; None of another one.

        The sample [rad/s], [m/s^2] is the next one that can be used by all other rules.
        """
        hangs = self._hangs(omega_ib_b, f_b)
        return self._repeated(omega_ib_b, f_b) or hangs or self._leaps(stamp_ns, omega_ib_b)

    def _hangs(self, omega_ib_b, f_b):
        gyros, accelerometers = self._gyros.hangs(omega_ib_b), self._accelerometers.hangs(f_b)
        if not (gyros or accelerometers):
            return None
        name, other = ('gyros', 'forces') if gyros else ('accelerometers', 'rates')
        sentence = f'the {name} repeat one sample, {gyros or accelerometers} times so far'
        return Verdict.IMPLAUSIBLE, f'{sentence}, and the {other} go on: they hang'

    def _repeated(self, omega_ib_b, f_b):
        if not self._most_repeats:
            return None
        values = omega_ib_b, f_b
        self._repeats = self._repeats + 1 if values == self._values else 0
        self._values = values
        if self._repeats <= self._most_repeats:
            return None
        sentence = f'the IMU repeats one sample, {self._repeats} times so far: it hangs'
        return Verdict.IMPLAUSIBLE, sentence

    def _leaps(self, stamp_ns, omega_ib_b):
        sample, used, odd = (stamp_ns, omega_ib_b), self._used, self._odd
        if (
            used is None
            or not self._is_leap(used, sample)
            or (odd is not None and not self._is_leap(odd, sample))
        ):
            self._used, self._odd = sample, None
            return None
        self._odd = sample
        size = max(abs(a - b) for a, b in zip(omega_ib_b, used[1], strict=True))
        return Verdict.IMPLAUSIBLE, (
            f'a rate {size:.3g} rad/s off the one before, max_rate_leap is '
            f'{self._most_leap:g} rad/s: a second one has to agree'
        )

    def _is_leap(self, before, after):
        most = self._most_leap + imu_sequence.SLEW * ((after[0] - before[0]) * 1e-9)
        return any(abs(a - b) > most for a, b in zip(after[1], before[1], strict=True))
