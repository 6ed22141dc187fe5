"""Columns of CSV files become a bag that gives the estimates of the recording they came from."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_samples import MAPPING, engine_parameters, recording, write

from polar_nav_core.attitude import euler_from_matrix
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section
from polar_nav_tools.bags import open_bag
from polar_nav_tools.foreign.findings import Refused
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.replay import replay
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.foreign.table import import_csv

COLUMNS = """
vehicle: auv
imu:
  file: imu.csv
  time: t
  rate: [p_degps, q_degps, r_degps]
  gyro_unit: deg/s
  force: [ax_g, ay_g, az_g]
  accel_unit: g
  rotation: frd
dvl:
  file: dvl.csv
  delimiter: semicolon
  time: when
  time_unit: iso
  velocity: [u, v, w]
  unit: mm/s
  valid: lock
  sigma: 0.005
depth: {file: depth.csv, time: ms, time_unit: ms, time_origin_s: 1772323200, depth: z, sigma: 0.05}
fixes:
  - file: fixes.csv
    source: leader
    time: valid
    time_unit: ns
    receive: received
    position: [lat, lon, height]
    frame: geodetic
    sigma_horizontal: 2.0
    sigma_vertical: 1.0
truth:
  file: truth.csv
  time: t
  position: [lat, lon, height]
  frame: geodetic
  heading: heading
  pitch: pitch_up
  roll: roll
"""


def put(
    path: Path, names: Sequence[str], rows: Iterable[Sequence[object]], mark: str = ','
) -> None:
    """Write a CSV file."""
    with path.open('w', newline='') as stream:
        writer = csv.writer(stream, delimiter=mark)
        writer.writerow(names)
        writer.writerows(rows)


def seconds(stamp_ns: int) -> str:
    """Epoch seconds with all nanoseconds."""
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference recording as CSV files, in other units, axes and times."""
    out = tmp_path_factory.mktemp('csv')
    r = recording()
    put(
        out / 'imu.csv',
        ['t', 'p_degps', 'q_degps', 'r_degps', 'ax_g', 'ay_g', 'az_g'],
        (
            [
                seconds(e.stamp_ns),
                *(repr(float(w)) for w in np.degrees(e.omega_ib_b) * [1, -1, -1]),
                *(repr(float(f)) for f in e.f_b / 9.80665 * [1, -1, -1]),
            ]
            for e in r.imu
        ),
    )
    put(
        out / 'dvl.csv',
        ['when', 'u', 'v', 'w', 'lock'],
        (
            [
                str(np.datetime64(d.stamp_ns, 'ns')) + 'Z',
                *(repr(float(v)) if d.valid else '' for v in 1e3 * d.v_m),
                int(d.valid),
            ]
            for d in r.dvl
        ),
        ';',
    )
    start = 1772323200 * 10**9
    rows = ([(h.stamp_ns - start) / 1e6, repr(h.depth)] for h in r.depth)
    put(out / 'depth.csv', ['ms', 'z'], rows)
    put(
        out / 'fixes.csv',
        ['valid', 'received', 'lat', 'lon', 'height'],
        ([f.validity_ns, f.receive_ns, *place(f.r_e)] for f in r.fixes),
    )
    truth = r.truth.rows(slice(0, None, 10))
    lat, lon, _ = geodetic_from_ecef(truth.r_e)
    psi, theta, phi = euler_from_matrix(truth.C_b_G)
    heading = np.degrees(0.5 * np.pi - psi + convergence(lat, lon))
    put(
        out / 'truth.csv',
        ['t', 'lat', 'lon', 'height', 'heading', 'pitch_up', 'roll'],
        (
            [
                seconds(int(truth.stamp_ns[k])),
                *place(truth.r_e[k]),
                repr(float(heading[k])),
                repr(float(-np.degrees(theta[k]))),
                repr(float(np.degrees(phi[k]))),
            ]
            for k in range(len(truth))
        ),
    )
    return out


def place(r_e: np.ndarray) -> list[str]:
    """Latitude, longitude [deg] and height, all digits."""
    lat, lon, height = (float(v) for v in geodetic_from_ecef(r_e))
    return [repr(float(np.degrees(lat))), repr(float(np.degrees(lon))), repr(height)]


def described(folder: Path, text: str) -> Path:
    """Write columns.yaml beside the files, with the parameters of the reference."""
    path = folder / 'columns.yaml'
    top = yaml.safe_load(text) | {'parameters': engine_parameters()}
    path.write_text(yaml.safe_dump(top, sort_keys=False))
    return path


def test_round_trip(folder: Path, tmp_path: Path) -> None:
    """CSV to bag to estimates: those of the same recording in a bag of other types."""
    result = import_csv(described(folder, COLUMNS), tmp_path / 'auv')
    bag = open_bag(result.bag)
    assert bag.is_complete
    r = recording()
    assert result.counts == {
        '/auv/imu/data_raw': len(r.imu),
        '/auv/dvl/data': len(r.dvl),
        '/auv/depth/data': len(r.depth),
        '/auv/fixes/leader': len(r.fixes),
        '/auv/truth': len(r.truth.rows(slice(0, None, 10))),
    }
    run = replay(open_source(result.bag), mapping_file.load(result.mapping))
    inputs = run.loaded.inputs
    assert np.array_equal(inputs.imu_stamps_ns, [e.stamp_ns for e in r.imu])
    assert np.abs(inputs.omega_ib_b - [e.omega_ib_b for e in r.imu]).max() < 1e-15
    assert np.abs(inputs.f_b - [e.f_b for e in r.imu]).max() < 1e-13
    assert [f.receive_ns for f in inputs.fixes] == [f.receive_ns for f in r.fixes]
    assert [f.validity_ns for f in inputs.fixes] == [f.validity_ns for f in r.fixes]
    assert (
        max(np.abs(a.r_e - b.r_e).max() for a, b in zip(inputs.fixes, r.fixes, strict=True)) < 1e-6
    )
    # The same sigmas in a bag of other types: only the way of the numbers differs.
    top = yaml.safe_load(MAPPING) | {'parameters': engine_parameters()}
    top['dvl']['sigma'], top['fixes'][0]['sigma'] = 0.005, [2.0, 1.0]
    other = replay(
        open_source(write(tmp_path / 'theirs')), mapping_file.from_section(Section('m', top))
    )
    ours, theirs = run.estimates, other.estimates
    assert np.array_equal(ours.stamp_ns, theirs.stamp_ns)
    assert np.abs(ours.r_e - theirs.r_e).max() < 1e-6
    assert np.abs(ours.v_G - theirs.v_G).max() < 1e-9
    truth = run.loaded.truth
    assert truth is not None
    same = r.truth.rows(slice(0, None, 10))
    assert np.abs(truth.C_b_G - same.C_b_G).max() < 1e-9
    assert np.abs(truth.r_e - same.r_e).max() < 1e-6
    assert run.comparison() is not None


def test_radians_mirrored_axes_and_ned(folder: Path, tmp_path: Path) -> None:
    """The same files in other conventions give the same bag, to the last bits of the units."""
    plain = import_csv(described(folder, COLUMNS), tmp_path / 'plain')
    r = recording()
    rows = list(csv.reader((folder / 'truth.csv').read_text().splitlines()))
    angles = [i for i, name in enumerate(rows[0]) if name not in ('t', 'height')]
    for row in rows[1:]:
        for i in angles:
            row[i] = repr(float(np.radians(float(row[i]))))
    truth = r.truth.rows(slice(0, None, 10))
    lat, lon, _ = geodetic_from_ecef(truth.r_e)
    v_e = np.einsum('nji,nj->ni', ecef_to_grid(truth.r_e), truth.v_G)
    east = np.column_stack([-np.sin(lon), np.cos(lon), 0.0 * lon])
    up = np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    ned = np.stack([np.cross(up, east), east, -up], axis=1) @ v_e[:, :, None]
    for row, velocity in zip(rows[1:], ned[:, :, 0], strict=True):
        row += [repr(float(v)) for v in velocity]
    put(folder / 'truth_rad.csv', [*rows[0], 'vn', 've', 'vd'], rows[1:])
    text = COLUMNS.replace('truth.csv', 'truth_rad.csv')
    text += '  angle_unit: rad\n  velocity_ned: [vn, ve, vd]\n'
    text = text.replace('rotation: frd', 'rotation: flu')
    text = text.replace('[p_degps, q_degps, r_degps]', '[p_degps, -q_degps, -r_degps]')
    text = text.replace('[ax_g, ay_g, az_g]', '[ax_g, -ay_g, -az_g]')
    other = import_csv(described(folder, text), tmp_path / 'other')
    a, b = (load(open_source(x.bag), mapping_file.load(x.mapping)) for x in (plain, other))
    assert np.array_equal(a.inputs.f_b, b.inputs.f_b)
    assert np.array_equal(a.inputs.omega_ib_b, b.inputs.omega_ib_b)
    assert np.abs(a.truth.r_e - b.truth.r_e).max() < 1e-6
    assert np.abs(a.truth.C_b_G - b.truth.C_b_G).max() < 1e-12
    assert np.abs(b.truth.v_G - truth.v_G).max() < 1e-9


def test_radians_that_nobody_stated(folder: Path, tmp_path: Path) -> None:
    """Degrees turn into a path 57 times shorter than the DVL's; nothing is integrated."""
    rows = list(csv.reader((folder / 'truth.csv').read_text().splitlines()))
    angles = [i for i, name in enumerate(rows[0]) if name in ('lat', 'lon')]
    for row in rows[1:]:
        for i in angles:
            row[i] = repr(float(np.radians(float(row[i]))))
    put(folder / 'truth_rad.csv', rows[0], rows[1:])
    made = import_csv(
        described(folder, COLUMNS.replace('truth.csv', 'truth_rad.csv')), tmp_path / 'auv'
    )
    with pytest.raises(Refused) as caught:
        load(open_source(made.bag), mapping_file.load(made.mapping))
    (finding,) = (f for f in caught.value.findings if f.name == 'path_length')
    assert '`angle_unit: rad`' in finding.text


def test_a_recording_that_begins_at_zero(tmp_path: Path) -> None:
    """Seconds since its own start: the first sample is one like any other."""
    n = 1000
    noise = np.random.default_rng(2).normal(0.0, 1e-3, (n, 6))
    rows = ([k / 100, *noise[k, :5], 9.81 + noise[k, 5]] for k in range(n))
    put(tmp_path / 'imu.csv', list('tpqrxyz'), rows)
    columns = {
        'imu': {'file': 'imu.csv', 'time': 't', 'rate': list('pqr'), 'force': list('xyz')},
        'initial': {'from': 'values', 'heading_deg': 10.0},
        'parameters': {'initial_latitude_deg': 32.85, 'initial_longitude_deg': -117.3},
    }
    (tmp_path / 'columns.yaml').write_text(yaml.safe_dump(columns))
    made = import_csv(tmp_path / 'columns.yaml', tmp_path / 'auv')
    run = replay(open_source(made.bag), mapping_file.load(made.mapping))
    assert run.loaded.inputs.imu_stamps_ns[0] == 0
    assert int(run.estimates.stamp_ns[-1]) == 9_990_000_000 // 10**8 * 10**8
    assert {f.name for f in run.findings} == {'noise_not_stated'}


@pytest.mark.parametrize(
    ('old', 'new', 'sentence'),
    [
        (
            'time: when',
            'time: whem',
            r"dvl: time: .*dvl\.csv has no column 'whem'; it has when, u",
        ),
        ('file: imu.csv', 'file: imo.csv', r'imu: file: .*imo\.csv: No such file'),
        ('unit: mm/s', 'unit: knots', r"dvl: unit: 'knots' is none of"),
        ('time_unit: iso', 'time_unit: s', r"dvl: time: .*column 'when': "),
        ('    receive: received\n', '', r'fixes\[0\]: receive: is missing'),
        ('  frame: geodetic\n  heading', '  heading', r'truth: frame: is missing'),
        ('force: [ax_g, ay_g, az_g]', 'force: [ax_g, ay_g]', r'imu: force: .* list of 3 columns'),
        ('vehicle: auv', 'vehicle: auv\ncolour: red', r'unknown key colour'),
    ],
)
def test_errors_name_file_and_column(
    folder: Path, tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    """A wrong name leads to the line in the YAML file; no half bag stays behind."""
    assert old in COLUMNS
    path = described(folder, COLUMNS.replace(old, new))
    with pytest.raises(ConfigError, match=sentence):
        import_csv(path, tmp_path / 'auv')
    assert not (tmp_path / 'auv').exists()


@pytest.mark.parametrize('time', ['1e300', '-1e10', '3e9', '-1'])
def test_a_time_that_no_stamp_can_hold(tmp_path: Path, time: str) -> None:
    put(tmp_path / 'imu.csv', 'txyz', [(0, 1, 2, 3), (time, 1, 2, 3)])
    text = 'imu: {file: imu.csv, time: t, rate: [x, y, z], force: [x, y, z]}\n'
    with pytest.raises(ConfigError, match=r"column 't': \S+ s in line 3 is no time"):
        import_csv(described(tmp_path, text), tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_a_device_is_no_csv_file(tmp_path: Path) -> None:
    text = 'imu: {file: /dev/zero, time: t, rate: [x, y, z], force: [x, y, z]}\n'
    with pytest.raises(ConfigError, match='/dev/zero is a device, not a regular file'):
        import_csv(described(tmp_path, text), tmp_path / 'bag')
