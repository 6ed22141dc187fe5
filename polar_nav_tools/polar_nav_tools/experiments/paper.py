"""Numbers printed in the paper's tables, for comparison.

Sensors 2018, 18, 1044: Table 1 (page with figure 8), Table 2 (figure 9), Table 3 (figure 11). RMS
errors; angles in arc minutes, velocity in m/s, position in m.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A row of the paper's tables."""

    key: str
    title: str
    unit: str


QUANTITIES = (
    Quantity('phi_x', 'φ_x', '′'),
    Quantity('phi_y', 'φ_y', '′'),
    Quantity('phi_z', 'φ_z', '′'),
    Quantity('v_x', 'v_x', 'm/s'),
    Quantity('v_y', 'v_y', 'm/s'),
    Quantity('r_x', 'r_x', 'm'),
    Quantity('r_y', 'r_y', 'm'),
)

_KEYS = tuple(q.key for q in QUANTITIES)


def _column(*values: float) -> dict[str, float]:
    return dict(zip(_KEYS, values, strict=True))


PAPER: dict[str, dict[str, dict[str, float]]] = {
    'table1': {
        'D1': _column(0.9893, 0.0646, 3.0777, 0.0045, 0.0520, 63.667, 28.437),
        'D2': _column(0.3130, 0.1698, 1.5085, 0.0083, 0.0184, 40.433, 21.082),
        'D3': _column(0.0474, 0.2496, 0.8161, 0.0150, 0.0401, 21.188, 13.080),
        'D4': _column(0.0734, 0.1341, 0.8719, 0.0202, 0.0028, 3.120, 4.240),
    },
    'table2': {
        'Algorithm 1': _column(0.0229, 0.0291, 1.2218, 0.0021, 0.0022, 37.3563, 9.5654),
        'Algorithm 2': _column(13.5681, 10.1113, 62.1246, 0.0550, 0.0355, 1252.2, 1244.7),
    },
    'table3': {
        'Algorithm 1': _column(0.0242, 0.0266, 1.2140, 0.0021, 0.0022, 37.1366, 9.4960),
        'Algorithm 2': _column(13.5848, 10.1178, 62.1555, 0.0551, 0.0355, 1253.2, 1244.3),
    },
}
"""By table and column. Algorithm 1 knows the delay (modified AKF), Algorithm 2 ignores it."""
