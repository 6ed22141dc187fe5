"""Interfaces of the filters that the engine drives in either mode, and of the identification."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ..arrays import Array, Ints
from ..identification.result import Identification
from .events import ControlSample, Event, Fix, ImuSample, InitialState, Local
from .outputs import Estimate
from .params import EngineParams
from .results import FixResult, Outcome
from .saved import SavedState


class Driver(Protocol):
    """Interface of a filter with its measurements and its strategy for late fixes."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample."""

    def begin(self, sample: ImuSample) -> None:
        """Start at the sample whose interval ends at the stamp of the initial state."""

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""

    def control(self, sample: ControlSample) -> None:
        """Store the thrust that holds from its stamp on."""

    def local(self, event: Local) -> Outcome:
        """Fuse a ping, depth or heading as valid now; returns the outcome of the update."""

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; None when the stored history does not reach back to its validity."""

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """Fix minus estimate at its validity, grid axes [m], and its NIS by the covariance now."""

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""

    def estimate(self, fixes: tuple[int, int, int]) -> Estimate:
        """Estimate at the newest IMU sample, with the local statistics since the last estimate."""

    def saved(self, fixes: tuple[int, int, int], records: tuple[bytes, bytes]) -> SavedState:
        """State as it is now, with its fixes, to go on from after a restart."""

    def height(self) -> float:
        """Height above the ellipsoid [m]; in station mode above the station's first position."""

    def adapt(self, identified: Identification) -> None:
        """Replace drag and current by those of an accepted identification."""

    def restore(self, lost: Driver) -> bool:
        """Begin with the newest sound state of a driver that was lost; False where there is none.

        It was made with any initial state, at the stamp of now.
        """


class Adaptation(Protocol):
    """Interface of an identification: stores fixes, attitude, thrust; adapts the filter."""

    def log(self, stamp_ns: int, C_b_G: Array, omega_b: Array, force_b: Array) -> None:
        """Store attitude, rate [rad/s] and thrust [N] at a stamp, at 10 Hz at most."""

    def fix(self, fix: Fix, outcome: Outcome, driver: Driver) -> Identification | None:
        """Store a fix with its outcome at the gate; returns the identification if one was due."""

    def identify(self, stamp_ns: int, trigger: str, driver: Driver | None) -> Identification:
        """Identification from the data stored so far, triggered by the named cause."""


class WholeArrays(Protocol):
    """Interface of a mode's arrays in its filter's streams (`sins.whole`, `station.whole`).

    Attributes
    ----------
    first : ImuSample or None
        First usable sample, at which the state starts.
    unusable : list of Event
        Samples that go one by one: those that are refused or ignored, and in station mode thrust
        and depth from before the state.
    """

    first: ImuSample | None
    unusable: list[Event]

    def new_seconds_ns(self) -> list[int]:
        """Stamps of the IMU samples with which a new second begins [ns]."""

    def too_sure_ns(self, stamp_ns: int) -> int | None:
        """When a ping last stated less noise than pings have, until a stamp [ns]; or None."""

    def start(self, driver: Driver | None, first: ImuSample) -> bool:
        """Hand the arrays to the filter started at the first sample; False without a filter."""

    def cursors(self) -> Ints:
        """Positions in the streams of the arrays."""

    def hand_over(self, driver: Driver | None, cursors: Ints) -> None:
        """Hand the arrays over to another filter, from positions on."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample processed [ns]."""

    def advance(self, until_ns: int, until_rank: int) -> bool:
        """Process all data before a stamp [ns] and rank; True if the rows were full before.

        Raises
        ------
        FilterDivergence
            When a covariance is not positive definite or the state not finite.
        """

    def put_row(self) -> None:
        """Write the present estimate to the rows."""

    def log(self, adaptation: Adaptation, until_ns: int) -> None:
        """Log data up to a stamp [ns] for an identification."""


Make = Callable[[EngineParams, InitialState, int], Driver]
"""Makes a driver from the parameters, the initial state and the stamp [ns] at which it holds."""
