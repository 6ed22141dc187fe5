"""Truth of all vehicles as serialized messages, made in blocks ahead of their use."""

from __future__ import annotations

from .mission import Mission
from .truth_cdr import encode

BLOCK_S = 1.0
"""Length of truth made at a time [s]; NumPy's overhead per call is spread over 100 samples."""


class TruthStream:
    """Serialized VehicleTruth messages of a mission.

    Parameters
    ----------
    mission : Mission
        The simulated mission.
    block_s : float
        Length of truth made at a time [s]; commands to a vehicle act from the next block on.
    """

    def __init__(self, mission: Mission, block_s: float = BLOCK_S) -> None:
        self._trajectories = {v: mission.truth(v) for v in mission.vehicles}
        self._start_ns = mission.start_ns
        self._period_ns = mission.imu_period_ns
        self._size = max(1, round(block_s * 1e9 / mission.imu_period_ns))
        self._blocks: dict[int, dict[str, list[bytes]]] = {}
        self.count = mission.sample_count
        """Samples per vehicle."""

    def stamp_ns(self, k: int) -> int:
        """Stamp of sample k [ns]."""
        return self._start_ns + k * self._period_ns

    def sample(self, k: int) -> dict[str, bytes]:
        """Messages of sample k by vehicle; samples are asked for in order."""
        block = k // self._size
        messages = self._block(block)
        for old in [b for b in self._blocks if b < block]:
            del self._blocks[old]
        i = k - block * self._size
        return {v: m[i] for v, m in messages.items()}

    def prepare(self, k: int) -> None:
        """Make the block after that of sample k, while there is time."""
        following = k // self._size + 1
        if following * self._size < self.count:
            self._block(following)

    def _block(self, number: int) -> dict[str, list[bytes]]:
        if number not in self._blocks:
            k0 = number * self._size
            k1 = min(k0 + self._size, self.count)
            self._blocks[number] = {
                v: encode(t.samples(k0, k1)) for v, t in self._trajectories.items()
            }
        return self._blocks[number]
