"""The polar map: projection against PROJ, graticule, labels."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.grid import ecef_to_grid
from polar_nav_tools.report.figures.chart import _crossings, length_label, round_length, window
from polar_nav_tools.report.graticule import angle_label, graticule
from polar_nav_tools.report.projection import PolarMap

LAT = np.deg2rad([60.0, 75.3, 80.0, 89.9, 89.99999])
LON = np.deg2rad([-179.99, -100.0, 0.0, 33.0, 180.0])


@pytest.mark.parametrize('hemisphere', [1, -1])
@pytest.mark.parametrize('true_deg', [71.0, 89.5, 90.0])
def test_projection_is_that_of_proj(hemisphere, true_deg):
    pyproj = pytest.importorskip('pyproj')
    proj = pyproj.Proj(
        proj='stere',
        lat_0=90 * hemisphere,
        lat_ts=true_deg * hemisphere,
        lon_0=0,
        ellps='WGS84',
    )
    x, y = proj(np.rad2deg(LON), np.rad2deg(hemisphere * LAT))
    chart = PolarMap(hemisphere, np.deg2rad(true_deg))
    found = chart.from_geodetic(hemisphere * LAT, LON)
    assert_allclose(found, np.stack([x, y], axis=1), atol=2e-3)


@pytest.mark.parametrize('hemisphere', [1, -1])
def test_there_and_back(hemisphere):
    chart = PolarMap(hemisphere, np.deg2rad(85.0))
    lat, lon = chart.to_geodetic(chart.from_geodetic(hemisphere * LAT, LON))
    assert_allclose(lat, hemisphere * LAT, atol=1e-12)
    assert_allclose(np.exp(1j * lon), np.exp(1j * LON), atol=1e-9)
    assert_allclose(chart.from_ecef(np.array([0.0, 0.0, hemisphere * 6356752.0])), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ('lat', 'lon', 'angle_deg'),
    [
        (90.0, 0.0, 1e-9),
        (89.99, 140.0, 1e-4),
        (80.0, 120.0, 0.4),
        (-80.0, 120.0, 0.4),
        (-90, 0, 0),
    ],
)
def test_map_axes_are_grid_axes(lat, lon, angle_deg):
    """A step along grid north goes up on the map, one along grid east to the right, in metres."""
    r_e = ecef_from_geodetic(np.deg2rad(lat), np.deg2rad(lon), 0.0)
    chart = PolarMap.around(np.deg2rad(np.array([lat])))
    C_e_G = ecef_to_grid(r_e)
    for axis, direction in ((0, [1.0, 0.0]), (1, [0.0, 1.0])):
        step = chart.from_ecef(r_e + 10.0 * C_e_G[axis]) - chart.from_ecef(
            r_e - 10.0 * C_e_G[axis]
        )
        assert np.hypot(*step) == pytest.approx(20.0, rel=1e-5)
        assert_allclose(step / 20.0, direction, atol=np.deg2rad(angle_deg) + 1e-5)


def test_nothing_to_map():
    with pytest.raises(ValueError, match='no finite value'):
        PolarMap.around(np.array([np.nan]))


CASES = [
    (80.0, 120.0, 2_000.0),
    (80.0, 180.0, 2_000.0),
    (89.99, -140.0, 2_000.0),
    (89.999, 10.0, 300.0),
    (-85.0, -100.0, 2_000.0),
    (75.0, 0.0, 500_000.0),
    (89.0, 60.0, 900_000.0),
]


@pytest.mark.parametrize(('lat', 'lon', 'size'), CASES)
def test_graticule_has_a_handful_of_lines_with_labels(lat, lon, size):
    chart = PolarMap.around(np.deg2rad(np.array([lat])))
    center = chart.from_geodetic(np.deg2rad(lat), np.deg2rad(lon))
    low, high = window(center + 0.4 * size * np.array([[-1.0, -1.0], [1.0, 1.0]]), 1.2)
    lines = graticule(chart, low, high)
    for parallel in (True, False):
        family = [one for one in lines if one.parallel == parallel]
        seen = [
            one
            for one in family
            if _crossings(one.xy, low, high) or ((one.xy > low) & (one.xy < high)).all()
        ]
        assert 2 <= len(seen) <= 14
        assert len({one.label for one in family}) == len(family)
    for one in lines:
        found_lat, found_lon = chart.to_geodetic(one.xy)
        value = found_lat if one.parallel else found_lon
        letters = 'NS' if one.parallel else 'EW'
        middle = float(np.rad2deg(value[len(value) // 2]))
        assert one.label in {angle_label(middle, letters), angle_label(abs(middle), letters)}


@pytest.mark.parametrize(
    ('degrees', 'letters', 'text'),
    [
        (80.0, 'NS', '80°N'),
        (-80.5, 'NS', '80°30′S'),
        (89.99999999, 'NS', '90°N'),
        (79.0 + 59.0 / 60 + 50.0 / 3600, 'NS', '79°59′50″N'),
        (120.0 + 0.5 / 3600, 'EW', '120°00′00.5″E'),
        (-120.25, 'EW', '120°15′W'),
        (0.0, 'EW', '0°'),
        (180.0, 'EW', '180°'),
    ],
)
def test_angle_labels(degrees, letters, text):
    assert angle_label(degrees, letters) == text


def test_lengths():
    assert [round_length(x) for x in (0.7, 1.0, 3.3, 49.0, 50.0, 99.0)] == [0.5, 1, 2, 20, 50, 50]
    assert [length_label(x) for x in (50.0, 1800.0, 1_112_000.0)] == [
        '50 m',
        '1.8 km',
        '1\u202f112 km',
    ]


def test_crossings_of_a_window():
    low, high = np.zeros(2), np.array([10.0, 5.0])
    line = np.array([[-1.0, 2.0], [5.0, 2.0], [5.0, 9.0]])
    assert _crossings(line, low, high) == [('left', 2.0), ('top', 5.0)]
