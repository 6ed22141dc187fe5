"""Numbers that stand for something in a message: they keep their meaning, for bags are kept."""

import re
from pathlib import Path

MESSAGES = Path(__file__).parents[1] / 'polar_nav_msgs'
CONSTANT = re.compile(r'^\s*(?:u?int\d+|byte)\s+([A-Z][A-Z0-9_]*)\s*=\s*(-?\d+)', re.MULTILINE)
FROZEN = {
    'Command': {
        'RESET': 0,
        'SET_INITIAL_STATE': 1,
        'SHUTDOWN': 2,
        'IDENTIFY': 3,
        'SENSOR_OFF': 5,
        'SENSOR_ON': 6,
    },
    'Dvl': {
        'DVL_MODE_BOTTOM': 1,
        'DVL_MODE_WATER': 2,
        'DVL_TYPE_PISTON': 0,
        'DVL_TYPE_PHASED_ARRAY': 1,
    },
    'FixReceipt': {
        'FUSED': 0,
        'GATED': 1,
        'DUPLICATE': 2,
        'TOO_OLD': 3,
        'TOO_LATE': 4,
        'FROM_FUTURE': 5,
        'NOT_FINITE': 6,
        'BAD_CRC': 7,
        'BAD_MAC': 8,
        'UNKNOWN_SOURCE': 9,
        'IN_FLIGHT': 10,
        'NOT_READY': 11,
        'BAD_FORMAT': 12,
        'IMPLAUSIBLE': 13,
        'REPLAYED': 14,
        'SWITCHED_OFF': 15,
    },
    'Identification': {
        'ACCEPTED': 0,
        'NOT_EXCITED': 1,
        'UNPHYSICAL': 2,
        'NOT_CONVERGED': 3,
        'TOO_FEW_FIXES': 4,
    },
    'NavHealth': {
        'OK': 0,
        'WARN': 1,
        'ERROR': 2,
        'STATUS_ALIGNING': 0,
        'STATUS_NAVIGATING': 1,
        'STATUS_DIVERGED': 2,
        'STATUS_DEGRADED': 3,
        'STATUS_LOST': 4,
        'FIXES': 1,
        'DVL': 2,
        'DEPTH': 4,
        'IMU': 8,
        'MODEL': 16,
        'HEADING': 32,
        'UNEXPLAINED': 64,
    },
    'NavState': {'STATUS_NAVIGATING': 1, 'STATUS_DIVERGED': 2},
}
"""New constants are added here; no number is changed, and none is used again."""


def test_constants_of_messages_keep_their_numbers():
    found = {}
    for path in sorted(MESSAGES.glob('*/*.[ms][sr][gv]')):
        constants = {n: int(v) for n, v in CONSTANT.findall(path.read_text(encoding='utf-8'))}
        if constants:
            found[path.stem] = constants
    assert found == FROZEN
