"""Innovation memories: every column is what it says, by sums over the whole history."""

import numpy as np
import pytest

from polar_nav_core.kernels import watch

# As watch.py states them: what would be another watchdog.
LENGTHS, LIMIT, RISE_LIMIT, MOST = (30.0, 300.0), 4.0, 2.0, 40.0
SHIFTS, NOISES, CALMS, ALIKE = (0.8, 0.25), (2.0, 1.3), (0.35, 0.5), (0.5, 0.2)
BLOCKS, BLOCK_NOISE = (10, 30), 2.0


class Attempts:
    """Attempts of one stream: innovations of m rows, and those by which a gate judges."""

    def __init__(self, m, seed, size=1.0, speed=2.0):
        self.rng = np.random.default_rng(seed)
        self.m, self.size, self.speed = m, size, speed
        self.rows = []

    def draw(self):
        """One more, as the arguments of `watch.observe`."""
        rng, m = self.rng, self.m
        S, S_gate = (self._covariance() for _ in range(2))
        z, z_gate = np.zeros(3), np.zeros(3)
        z[:m] = self.size * np.linalg.cholesky(S)[:m, :m] @ rng.standard_normal(m)
        z_gate[:m] = self.size * np.linalg.cholesky(S_gate)[:m, :m] @ rng.standard_normal(m)
        nis = z[:m] @ np.linalg.solve(S[:m, :m], z[:m])
        course = rng.uniform(0.0, 2.0 * np.pi)
        v = self.speed * np.array([np.cos(course), np.sin(course)])
        fused = bool(rng.random() < 0.7)
        self.rows.append((z, S, nis, fused, v, z_gate, S_gate))
        return z, S, nis, m, fused, v[0], v[1], z_gate, S_gate

    def _covariance(self):
        A = self.rng.standard_normal((3, 3))
        return A @ A.T + 0.5 * np.eye(3)

    def axes(self, z, S, v):
        """Innovation per sigma along grid axes (3), along track, across, up (3)."""
        if self.m == 1:
            up = np.clip(z[0] / np.sqrt(S[0, 0]), -LIMIT, LIMIT)
            return np.array([0.0, 0.0, up]), np.array([0.0, 0.0, up])
        ahead = v / np.hypot(*v) if np.hypot(*v) > 0.05 else np.array([1.0, 0.0])
        C = np.array([[ahead[0], ahead[1], 0.0], [-ahead[1], ahead[0], 0.0], [0.0, 0.0, 1.0]])
        grid = z / np.sqrt(np.diagonal(S))
        track = C @ z / np.sqrt(np.diagonal(C @ S @ C.T))
        return np.clip(grid, -LIMIT, LIMIT), np.clip(track, -LIMIT, LIMIT)

    def memory(self, k):
        """Columns of memory k, from the whole history."""
        n, out = len(self.rows), np.zeros(watch.WIDTH)
        weights = np.exp(-(n - 1.0 - np.arange(n)) / LENGTHS[k])
        sums = np.array([self._summed(*row) for row in self.rows])
        out[: watch.SUMS] = weights @ sums
        out[watch.WEIGHT_2] = np.sum(weights**2)
        self._rises(out, k)
        return out

    def _summed(self, z, S, nis, fused, v, z_gate, S_gate):
        grid, track = self.axes(z, S, v)
        gate, gate_track = self.axes(z_gate, S_gate, v)
        side = 0.0
        if self.m > 1:
            ahead = v / np.hypot(*v) if np.hypot(*v) > 0.05 else np.array([1.0, 0.0])
            side = (ahead[0] * z_gate[1] - ahead[1] * z_gate[0]) / np.hypot(*z_gate[:2])
        ratio = min(nis / self.m, LIMIT**2)
        parts = [1.0, 0.0, ratio, not fused, *grid, *track, *track**2, side, *gate, *gate_track**2]
        return np.array(parts, dtype=float)

    def _rises(self, out, k):
        """Cumulative sums, innovation by innovation."""
        m, d, rho = self.m, SHIFTS[k], ALIKE[k]
        before, block = np.zeros(m), []
        for z, S, nis, _, v, _, _ in self.rows:
            grid, track = self.axes(z, S, v)
            first = 2 if m == 1 else 0
            for at, values in ((watch.GRID_RISE, grid), (watch.TRACK_RISE, track)):
                for axis in range(first, 3):
                    gain = d * np.clip(values[axis], -RISE_LIMIT, RISE_LIMIT)
                    for side, sign in enumerate((1.0, -1.0)):
                        i = at + 2 * axis + side
                        out[i] = np.clip(out[i] + sign * gain - 0.5 * d * d, 0.0, MOST)
            ratio = min(nis / m, LIMIT**2)
            self._add(out, watch.NOISE_RISE, gaussian(m * min(ratio, 4.0), m, NOISES[k]))
            self._add(out, watch.CALM_RISE, gaussian(m * ratio, m, CALMS[k]))
            white = np.linalg.solve(np.linalg.cholesky(S[:m, :m]), z[:m])
            white = np.clip(white, -RISE_LIMIT, RISE_LIMIT)
            rest = 1.0 - rho**2
            off = np.sum((white - rho * before) ** 2) / rest
            self._add(out, watch.ALIKE_RISE, 0.5 * (white @ white - off - m * np.log(rest)))
            before = white
            block.append(white)
            if len(block) == BLOCKS[k]:
                total, scatter = np.sum(block, axis=0), max(1.0, np.mean(np.square(block)))
                square = min(total @ total / len(block) / scatter, m * LIMIT**2)
                self._add(out, watch.BLOCK_RISE, gaussian(square, m, BLOCK_NOISE))
                block = []
        out[watch.LAST : watch.LAST + m] = before
        if block:
            out[watch.BLOCK : watch.BLOCK + m] = np.sum(block, axis=0)
            out[watch.BLOCK_NUMBER], out[watch.BLOCK_SQUARE] = len(block), np.sum(np.square(block))

    @staticmethod
    def _add(out, at, ratio):
        out[at] = np.clip(out[at] + ratio, 0.0, MOST)


def gaussian(square, m, variances):
    """Log likelihood ratio of m numbers with a variance against 1, from the sum of squares."""
    return 0.5 * (square - square / variances - m * np.log(variances))


@pytest.mark.parametrize(
    ('m', 'size', 'speed'),
    [(3, 1.0, 2.0), (3, 2.5, 2.0), (3, 0.4, 0.04), (3, 6.0, 0.06), (1, 1.0, 2.0), (1, 3.0, 2.0)],
)
def test_a_memory_is_that_of_the_whole_history(m, size, speed):
    attempts = Attempts(m, 5, size, speed)
    kept = np.zeros((watch.MEMORIES, watch.WIDTH))
    for k in range(95):
        watch.observe(kept, *attempts.draw())
        if k in {0, 1, 12, 94}:
            for memory in range(watch.MEMORIES):
                expected = attempts.memory(memory)
                np.testing.assert_allclose(kept[memory], expected, rtol=1e-9, atol=1e-9)


def test_sums_are_held_between_zero_and_the_most():
    kept, one = np.zeros((watch.MEMORIES, watch.WIDTH)), np.eye(3)
    z = np.array([3.0, 3.0, 3.0])
    for _ in range(2000):
        watch.observe(kept, z, one, 27.0, 3, True, 2.0, 0.0, z, one)
    up, down = watch.GRID_RISE, watch.GRID_RISE + 1
    assert kept[:, up].tolist() == [MOST, MOST]
    assert kept[:, down].tolist() == [0.0, 0.0]
    assert kept[:, watch.NOISE_RISE].tolist() == [MOST, MOST]
