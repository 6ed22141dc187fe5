"""Bags of a fleet for tests: few, short, and not equal."""

import gc
import shutil
import sys
from pathlib import Path

from polar_nav_tools.bags import BagWriter, open_bag
from polar_nav_tools.bags.recover import add_topic
from polar_nav_tools.bags.remote.address import _looked
from polar_nav_tools.cli import main
from polar_nav_tools.fleet import task as fleet_task

BAGS = Path(__file__).resolve().parents[2] / 'bags'
REFERENCE, STATION = BAGS / 'reference', BAGS / 'station'


def shortened(folder, seconds, source=REFERENCE):
    """First seconds of a bag as one of its own; returns its .mcap file."""
    bag = open_bag(source)
    first_ns = next(log_ns for _, log_ns, _ in bag.messages())
    info = {k: v for k, v in bag.run_info.items() if k != 'recording'}  # it counts messages
    with BagWriter(folder, info) as writer:
        for topic in bag.topics:
            add_topic(writer, bag, topic)
        for m in bag.records():
            if m.log_time_ns - first_ns <= seconds * 1e9:
                writer.write(m.topic, m.data, m.log_time_ns, m.publish_time_ns, m.sequence)
    return writer.path


def fleet(folder):
    """Folder with three bags: a whole one, a short one and one that is none."""
    for name in ('a', 'b', 'c'):
        (folder / name).mkdir(parents=True)
    shutil.copy(REFERENCE / 'reference_0.mcap', folder / 'a' / 'whole.mcap')
    short = shortened(folder / 'short', 20.0)
    shutil.move(short, folder / 'b' / 'short.mcap')
    shutil.rmtree(folder / 'short')
    (folder / 'c' / 'text.mcap').write_text('this is no bag')
    return folder


def as_a_new_process(monkeypatch, capsys, tmp_path):
    """Fixture: the command, which knows of no bag; returns its status and what it said."""
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        fleet_task._newest.clear()
        _looked.clear()
        gc.collect()
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run
