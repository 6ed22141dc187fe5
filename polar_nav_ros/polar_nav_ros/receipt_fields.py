"""Fields of a receipt: their names in the event, in the message and in a row of a bag, once.

What is not in these tables is special in every form: the stamp of the decision stands in the
header, the verdict is a number with a name, and the age is derived from two times.
"""

from __future__ import annotations

TIMES = {f'{name}_ns': f'{name}_time' for name in ('validity', 'transmit', 'receive', 'fused')}
"""Times by attribute of `outputs.Receipt` [ns]: field of FixReceipt."""
AXES = {'innovation_G': 'innovation_g', 'innovation_variance_G': 'innovation_variance_g'}
"""Triples of numbers by attribute of `outputs.Receipt`: field of FixReceipt."""
VALUES = {
    'reason': 'reason',
    'topic': 'topic',
    'source': 'source',
    'sequence': 'sequence',
    'revision': 'revision',
    'delay_handling': 'delay_handling',
    'steps_rolled_back': 'steps_rolled_back',
    'nis': 'nis',
    'dof': 'degrees_of_freedom',
    'gate': 'gate',
}
"""Texts and numbers by attribute of `outputs.Receipt`: field of FixReceipt."""
