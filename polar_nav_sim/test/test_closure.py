"""The closure table of docs/simulation.md, in small."""

from polar_nav_sim.closure import closure, main
from polar_nav_sim.mission import load_mission


def test_closure_falls_with_the_third_power_of_the_interval():
    left = []
    for rate in (50.0, 100.0, 200.0):
        mission = load_mission('demo').with_overrides({'imu_rate_hz': rate, 'duration_s': 120.0})
        left.append(closure(mission, 'follower').position_m)
    assert 6.0 < left[0] / left[1] < 10.0
    assert 5.0 < left[1] / left[2] < 11.0


def test_the_command_prints_its_table(capsys):
    assert main(['over_pole', '--duration-s', '10']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ['mission', 'IMU', '[Hz]']
    assert [line.split()[:2] for line in lines[1:]] == [
        ['over_pole', '50'],
        ['over_pole', '100'],
        ['over_pole', '200'],
    ]
    assert all(float(line.split()[2]) < 1e-4 for line in lines[1:])
