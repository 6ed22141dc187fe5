"""The story of a fix as plain data for JSON."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from polar_nav_core.link.packet import Broadcast

from ..scoring.json_values import jsonable
from ..series.vehicle import ReceiptRecord
from .content import Content
from .damage import Damage
from .legs import Leg
from .records import Packet
from .story import Copy, Story
from .words import headline, paragraphs


def document(s: Story) -> dict[str, object]:
    """Story as values for JSON: stamps in ns, SI units and radians, None for NaN."""
    copy = s.copy
    final = copy.final if copy is not None else None
    return {
        'headline': headline(s),
        'sequence': s.sequence,
        'source': s.source,
        'vehicle': s.vehicle,
        'configuration': s.configuration,
        'replayed': s.replayed,
        'fate': s.fate,
        'verdict': final.verdict_text if final is not None else None,
        'start_ns': s.zero_ns,
        'measured': jsonable(asdict(s.measured)) if s.measured is not None else None,
        'sent': [_packet(p) for p in s.sent],
        'received': [_copy(c) for c in s.copies],
        'legs': [_leg(leg) for leg in s.legs],
        'expected_ns': s.expected_ns,
        'broadcast': _broadcast(s.broadcast) if s.broadcast is not None else None,
        'belief': jsonable(asdict(s.belief)) if s.belief is not None else None,
        'change': jsonable(asdict(s.change)) if s.change is not None else None,
        'meanwhile': [jsonable(asdict(o)) for o in s.others],
        'receipts_without_packet': [_receipt(r) for r in s.loose],
        'story': {title: sentences for title, sentences in paragraphs(s)},
    }


def _leg(leg: Leg) -> dict[str, object]:
    return {
        'name': leg.name,
        'start_ns': leg.start_ns,
        'stop_ns': leg.stop_ns,
        'seconds': leg.seconds,
        'how': leg.how,
        'counted': leg.counted,
    }


def _packet(p: Packet) -> dict[str, object]:
    return {
        'source': p.source,
        'packet': p.order,
        'transmit_ns': p.transmit_ns,
        'receive_ns': p.receive_ns or None,
        'bit_rate': jsonable(p.bit_rate),
        'bytes': p.data.hex(),
        'problem': p.problem or None,
    }


def _copy(c: Copy) -> dict[str, object]:
    return {
        **_packet(c.packet),
        'verdict': c.verdict,
        'damage': _damage(c.damage) if c.damage is not None else None,
        'receipts': [_receipt(r) for r in c.receipts],
    }


def _damage(d: Damage) -> dict[str, object]:
    return {
        'crc_computed': d.computed,
        'crc_said': d.stated,
        'bits_flipped': d.bits,
        'bytes': list(d.differing),
        'fields': list(d.fields),
    }


def _receipt(r: ReceiptRecord) -> object:
    return jsonable(asdict(r))


def _broadcast(b: Content) -> object:
    if not isinstance(b, Broadcast):
        return jsonable(asdict(b))
    sigma = np.sqrt(np.diagonal(b.r_lf_covariance_G))
    return jsonable({**asdict(b), 'r_lf_sigma_G': sigma})
