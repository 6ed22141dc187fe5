"""Helper modules importable in any import mode; hypothesis repeatable and without a deadline."""

import sys
from pathlib import Path

import numba
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

# A first call may compile a kernel for seconds; the same examples each time, and no database in
# the tree.
settings.register_profile('core', deadline=None, derandomize=True, database=None)
settings.load_profile('core')

if numba.config.DISABLE_JIT:
    # In plain Python the engine takes a thousand times as long; test_plain_engine.py, in a process
    # of its own, sees to it that its numbers are the same. Identifications take minutes. Where a
    # few tests of a file are slow, those are marked as `compiled.jit_only`.
    collect_ignore = [
        f'test_{name}.py'
        for name in [
            'batch',
            'clocks',
            'clone',
            'delay_sigma',
            'delay_strategies',
            'disagreement',
            'engine',
            'hindsight',
            'identification_published',
            'identification_robust',
            'identification_triggers',
            'imu_gap',
            'innovations',
            'integrity',
            'leader_error',
            'local_statistics',
            'looks',
            'missing_samples',
            'model_aiding',
            'model_fallback',
            'never_dead',
            'noise_formulas',
            'noise_strategies',
            'now',
            'plain_engine',
            'reopen',
            'reorder',
            'replaced',
            'restart',
            'robust',
            'runaway',
            'scale',
            'signatures',
            'slow_faults',
            'smoothing',
            'spoofed_fixes',
            'stated_common_errors',
            'station_common',
            'station_delays',
            'station_engine',
            'station_gap',
            'station_obey',
            'station_signatures',
            'station_trust',
            'switches',
            'turn_rows',
            'warm',
            'water_track',
        ]
    ]
