"""What the engine drives: a filter of either mode with its measurements, and an identification."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from ..identification.result import Identification
from .events import (
    Array,
    ControlSample,
    DepthSample,
    DvlPing,
    Estimate,
    Fix,
    ImuSample,
    InitialState,
)
from .params import EngineParams
from .results import FixResult, Outcome


class Driver(Protocol):
    """What the engine drives: a filter with its measurements and its way to treat late fixes."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample."""

    def begin(self, sample: ImuSample) -> None:
        """Take the sample that ends where the state starts."""

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""

    def control(self, sample: ControlSample) -> None:
        """Take note of the thrust."""

    def local(self, event: DvlPing | DepthSample) -> Outcome:
        """Fuse DVL or depth: never treated as delayed."""

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; None when the stored history does not reach back to its validity."""

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """How far a fix is off, grid axes [m], and its NIS by the covariance of now."""

    def oldest_ns(self) -> int:
        """Oldest validity that a fix may have to be fused."""

    def estimate(self, fixes: tuple[int, int, int]) -> Estimate:
        """Estimate at the newest IMU sample; takes the local statistics since the last one."""

    def height(self) -> float:
        """Of the vehicle [m]; in station mode above the station's first position."""

    def adapt(self, identified: Identification) -> None:
        """Take drag and current from an identification that was accepted."""


class Adaptation(Protocol):
    """Collects fixes, attitude and thrust; identifies when it is time; tells the filter."""

    def log(self, stamp_ns: int, C_b_G: Array, omega_b: Array, force_b: Array) -> None:
        """Take attitude, rate and the thrust of the moment; more than 10 Hz are passed over."""

    def fix(self, fix: Fix, outcome: Outcome, driver: Driver) -> Identification | None:
        """Take a fix that the gate decided on; identify if it is time."""

    def identify(self, stamp_ns: int, trigger: str, driver: Driver | None) -> Identification:
        """Identify now."""


Make = Callable[[EngineParams, InitialState, int], Driver]
"""Makes a driver from the parameters, the initial state and the stamp [ns] at which it holds."""
