"""A recording whose mapping states no place and no heading: aligned under way. Another truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_worlds import (
    IMU,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    stamps_of,
    truth_of,
    write_columns,
)
from test_live_headings import HEADING, with_orientation

from polar_nav_core.attitude import log, matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.replay import run
from polar_nav_tools.foreign.sources import open_source

SECONDS = 160.0


def recorded(
    path: Path, *, dvl: bool = True, lever_b: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[Path, dict[str, Any]]:
    """A bag of a vehicle under way, and a mapping that does not state where it starts."""
    truth, make = truth_of(SECONDS), Recorder()
    stamps = stamps_of(truth, 0.0, SECONDS, 0.01)
    columns = [imu_column(make, truth, stamps, lever_b=lever_b)]
    columns += aiding_columns(make, truth, 0.0, SECONDS)
    top = mapping({'lever_b': list(lever_b)})
    del top['initial']
    if not dvl:
        del top['dvl']
    return write_columns(path, make, columns), top


@pytest.mark.parametrize('lever_b', [(0.0, 0.0, 0.0), (1.2, -0.2, 0.3)])
def test_it_is_aligned_under_way_and_the_errors_are_as_stated(
    tmp_path: Path, lever_b: tuple[float, ...]
) -> None:
    path, top = recorded(tmp_path / 'bag', lever_b=lever_b)
    loaded = load(open_source(path), mapping_file.from_section(Section('m', top)))
    assert loaded.start.how.startswith('aligned: place from fixes of')
    assert 'by the course over' in loaded.start.how
    state = loaded.params.initial_state()
    assert state is not None
    truth = truth_of(SECONDS).state(np.array([loaded.start.stamp_ns]))
    C = matrix_from_euler(0.5 * np.pi - state.grid_heading, state.pitch, state.roll)
    phi = log(C @ truth.C_b_G[0].T)
    assert abs(phi[2]) < 3.0 * state.sigma_heading
    assert np.abs(phi[:2]).max() < 4.0 * state.sigma_tilt
    r_e = ecef_from_geodetic(state.latitude, state.longitude, state.height)
    off = truth.C_e_G[0] @ (r_e - truth.r_e[0])
    assert np.hypot(off[0], off[1]) < 4.0 * state.sigma_position_horizontal
    assert abs(off[2]) < 4.0 * state.sigma_position_vertical
    assert np.abs(np.array(state.v_G) - truth.v_G[0]).max() < 4.0 * state.sigma_velocity
    comparison = run(loaded).comparison()
    assert comparison is not None


def test_a_measured_heading_starts_it_without_a_dvl(tmp_path: Path) -> None:
    truth, make = truth_of(SECONDS), Recorder()
    imu = imu_column(make, truth, stamps_of(truth, 0.0, 60.0, 0.01))
    columns = [with_orientation(imu, truth, 'enu'), *aiding_columns(make, truth, 0.0, 60.0)]
    top = mapping()
    del top['initial'], top['dvl']
    top['heading'] = HEADING | {'topic': IMU, 'coloured_sigma_deg': 1.0}
    path = write_columns(tmp_path / 'bag', make, columns)
    loaded = load(open_source(path), mapping_file.from_section(Section('m', top)))
    assert 'heading measured by heading/data (true north)' in loaded.start.how
    state = loaded.params.initial_state()
    assert state is not None
    true = truth.state(np.array([loaded.start.stamp_ns])).C_b_G[0]
    turned = state.grid_heading - np.arctan2(true[0, 0], true[1, 0])
    assert abs(np.angle(np.exp(1j * turned))) < np.radians(0.5)
    assert len(loaded.inputs.headings) > 1000


def test_without_a_dvl_it_is_refused_with_what_is_missing(tmp_path: Path) -> None:
    path, top = recorded(tmp_path / 'bag', dvl=False)
    with pytest.raises(ConfigError, match='without a DVL the course of two fixes is no heading'):
        load(open_source(path), mapping_file.from_section(Section('m', top)))
