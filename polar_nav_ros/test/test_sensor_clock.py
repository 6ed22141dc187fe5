"""A sensor's clock on the host's time: offset, drift, steps, and nothing of other sensors."""

import numpy as np
import pytest

from polar_nav_ros.adapters.sensor_clock import SensorClock

NS = 1_000_000_000
START_NS = 1_772_323_200 * NS


def stream(rng, seconds, rate_hz, offset_s, drift=0.0, least_s=0.002, jitter_s=0.02):
    """True host times of validity, stamps and arrivals [ns]."""
    true_ns = START_NS + (np.arange(seconds * rate_hz) * (NS // rate_hz)).astype(np.int64)
    since_s = (true_ns - START_NS) * 1e-9
    stamps_ns = true_ns + np.round((offset_s + drift * since_s) * 1e9).astype(np.int64)
    delays_s = least_s + rng.exponential(jitter_s, len(true_ns))
    return true_ns, stamps_ns, true_ns + np.round(delays_s * 1e9).astype(np.int64)


def mapped(clock, stamps_ns, arrivals_ns):
    return np.array(
        [clock.host_ns(int(s), int(a)) for s, a in zip(stamps_ns, arrivals_ns, strict=True)]
    )


@pytest.mark.parametrize('rate_hz', [5, 50])
@pytest.mark.parametrize('offset_s', [-1.7e9, 0.0, 3600.25])
def test_a_constant_offset_is_found_to_the_least_delay(rate_hz, offset_s):
    true_ns, stamps_ns, arrivals_ns = stream(np.random.default_rng(1), 120, rate_hz, offset_s)
    error_s = (mapped(SensorClock(), stamps_ns, arrivals_ns) - true_ns) * 1e-9
    # Later by the least delay, which nobody can tell, and by what is left of the jitter: in each
    # second, at 5 Hz, the quickest of five; of minutes the quickest of all.
    assert np.all(error_s[20 * rate_hz :] >= 0.0019)
    assert np.median(error_s[60 * rate_hz :]) < 0.006


@pytest.mark.parametrize('drift', [-80e-6, 30e-6, 200e-6])
def test_drift_is_followed(drift):
    rng = np.random.default_rng(2)
    true_ns, stamps_ns, arrivals_ns = stream(rng, 900, 10, 12.0, drift)
    clock = SensorClock()
    error_s = (mapped(clock, stamps_ns, arrivals_ns) - true_ns) * 1e-9
    assert -clock.drift == pytest.approx(drift, abs=20e-6)
    assert np.abs(error_s[1200:] - 0.002).max() < 0.01
    # A fit without drift would be off by 200 ppm times minutes.


def test_a_step_begins_the_fit_anew_and_only_there():
    rng = np.random.default_rng(3)
    true_ns, stamps_ns, arrivals_ns = stream(rng, 200, 10, 5.0)
    stamps_ns[1000:] -= 3600 * NS
    clock, other = SensorClock(), SensorClock()
    out = mapped(clock, stamps_ns, arrivals_ns)
    assert clock.steps == 1
    error_s = (out - true_ns) * 1e-9
    assert np.abs(error_s[1004:]).max() < 0.12  # the first after it have the jitter of a few
    assert np.abs(error_s[1300:]).max() < 0.03
    true_ns, stamps_ns, arrivals_ns = stream(np.random.default_rng(4), 200, 10, 0.0)
    mapped(other, stamps_ns, arrivals_ns)
    assert other.steps == 0


def test_one_late_message_is_no_step_and_keeps_its_time():
    rng = np.random.default_rng(5)
    true_ns, stamps_ns, arrivals_ns = stream(rng, 60, 10, 5.0)
    arrivals_ns[400] += 3 * NS
    clock = SensorClock()
    error_s = (mapped(clock, stamps_ns, arrivals_ns) - true_ns) * 1e-9
    assert clock.steps == 0
    assert abs(error_s[400]) < 0.02


def test_no_message_is_of_a_time_after_its_arrival():
    rng = np.random.default_rng(6)
    _, stamps_ns, arrivals_ns = stream(rng, 300, 10, 0.3, 400e-6)
    assert np.all(mapped(SensorClock(), stamps_ns, arrivals_ns) <= arrivals_ns)
