"""Fixes without a height: sizes, gates, weights and offsets of two numbers."""

from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.integrity import IntegrityMonitor
from polar_nav_core.engine.level import in_its_size, is_level, levelled, size_of
from polar_nav_core.engine.results import Outcome, chi2_gate
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.judge import size_of as rows_that_say_something
from polar_nav_core.level import LEVEL_SIGMA


def fix(sigma_up, latitude=1.2):
    r_e = ecef_from_geodetic(latitude, 0.7, 0.0)
    C_e_G = np.asarray(ecef_to_grid(r_e))
    P = C_e_G.T @ np.diag([4.0, 4.0, sigma_up**2]) @ C_e_G
    return Fix(1, 1, 2, 'ugps', 1, 1, 1, r_e=r_e, covariance_e=P)


@pytest.mark.parametrize(
    ('sigma_up', 'level'), [(2.0, False), (300.0, False), (LEVEL_SIGMA, True)]
)
@pytest.mark.parametrize('latitude', [1.2, -1.5707, 0.0])
def test_a_fix_is_as_many_numbers_as_it_states(sigma_up, level, latitude):
    found = fix(sigma_up, latitude)
    assert is_level(found) is level
    assert size_of(found) == (2 if level else 3)
    offset_G = np.array([1.0, 2.0, 300.0])
    assert levelled(offset_G, found).tolist() == [1.0, 2.0, 0.0 if level else 300.0]
    whole = Outcome(True, np.zeros(3), np.ones(3), 1.0, 3, chi2_gate(0.9999, 3))
    sized = in_its_size(whole, found, 0.9999)
    assert (sized.dof, sized.gate) == ((2, chi2_gate(0.9999, 2)) if level else (3, whole.gate))


def test_wide_level_axes_are_no_height():
    """10 km of sigma along the ground: the height is known, and counts."""
    found = fix(2.0)
    wide = replace(found, covariance_e=found.covariance_e + LEVEL_SIGMA**2 * np.eye(3))
    C_e_G = np.asarray(ecef_to_grid(found.r_e))
    up = C_e_G[2]
    known = wide.covariance_e - LEVEL_SIGMA**2 * np.outer(up, up)
    assert not is_level(replace(found, covariance_e=known))
    assert is_level(wide)


@pytest.mark.parametrize(
    ('stream', 'm', 'sigma_up', 'size'),
    [
        (fs.FIX_ROW, 3, LEVEL_SIGMA, 2),
        (fs.FIX_ROW, 3, 300.0, 3),
        (fs.DVL_ROW, 3, LEVEL_SIGMA, 3),
        (fs.DEPTH_ROW, 1, LEVEL_SIGMA, 1),
    ],
)
def test_rows_that_say_something(stream, m, sigma_up, size):
    R = np.diag([1.0, 1.0, sigma_up**2])
    assert rows_that_say_something(R, stream, m) == size


def test_scattered_fixes_at_another_height_are_not_believed():
    """Twelve after a start, 20 m around the vehicle and 300 m above it: that is no offset."""
    rng = np.random.default_rng(2)
    level = fix(LEVEL_SIGMA)
    found = {}
    for name, of in (('level', lambda d: levelled(d, level)), ('whole', lambda d: d)):
        monitor = IntegrityMonitor(60.0)
        for k in range(12):
            angle = rng.uniform(0.0, 2.0 * np.pi)
            offset_G = np.array([20.0 * np.cos(angle), 20.0 * np.sin(angle), 300.0])
            monitor.gated(k * 10**9, k * 10**9, of(offset_G))
        found[name] = monitor.contradiction(0, doubted=False, least_s=5.0)
    assert found['level'] is None
    assert found['whole'] is not None
