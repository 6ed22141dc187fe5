"""Text of a fix's story: paragraphs with headings, from the records alone."""

from __future__ import annotations

import math

import numpy as np

from polar_nav_core.link.station_packet import StationReport

from ..series.vehicle import ReceiptRecord
from .damage import Damage
from .effects import Belief, Change
from .story import ARRIVED, IN_WATER, NOT_SENT, WAITING, Copy, Story

Paragraph = tuple[str, list[str]]

_AXES = ('east', 'north', 'up')

_MEANING = {
    'FUSED': 'used',
    'GATED': 'refused by the chi-square gate',
    'DUPLICATE': 'refused: this fix was received before',
    'TOO_OLD': 'refused: too old',
    'TOO_LATE': 'refused: later events were already processed',
    'FROM_FUTURE': 'refused: valid after it was received',
    'NOT_FINITE': 'refused: numbers that cannot be used',
    'IMPLAUSIBLE': 'refused: beyond what its sensor can say',
    'BAD_CRC': 'refused: damaged on the way',
    'BAD_MAC': 'refused: authentication failed',
    'UNKNOWN_SOURCE': 'refused: not from our leader, or not for this vehicle',
    'IN_FLIGHT': 'still on its way when the run ended',
    'NOT_READY': 'not used: the filter had no state',
    'BAD_FORMAT': 'refused: not a packet that can be read',
    'REPLAYED': 'refused: content of an earlier fix under another number',
    'SWITCHED_OFF': 'not used: a service call had switched its sensor off',
}
_HANDLING = {
    'ignore': 'fused as if valid at its reception',
    'tagged': 'innovation at the time of validity, applied to the present',
    'back_propagate': 'brought back through the stored transitions (H Phi^-1)',
    'clone': 'carried through the stored linear steps, exact on them',
    'rewind': 'filter restored at the time of validity, all later measurements processed again',
}


def headline(s: Story) -> str:
    """Sentence with age, verdict and effect of the fix."""
    name = f'Fix {s.sequence} of {s.source} for {s.vehicle}'
    copy = s.copy
    if copy is None:
        return f'{name} {_fate(s)}.'
    final = copy.final
    if final is None:
        return f'{name} was received, and there is no receipt of it.'
    age = f', {final.age_s:.2f} s old' if math.isfinite(final.age_s) else ''
    text = f'{name}{age}: {_MEANING.get(final.verdict_text, "not used")} ({final.verdict_text})'
    if final.verdict_text == 'FUSED' and s.change is not None:
        moved = float(np.hypot(*s.change.shift[:2]))
        text += f'; it moved the position by {_m(moved)}'
    return text + '.'


def paragraphs(s: Story) -> list[Paragraph]:
    """All paragraphs of the story, in the order of events."""
    out: list[Paragraph] = [('Times', _times(s)), ('Delays', _delays(s))]
    if s.broadcast is not None:
        out.append((f'Content of the packet, by the {_sender(s)}', _content(s)))
    if s.belief is not None:
        out.append(('Estimate of the follower', _estimated(s.belief)))
    out += [_copy_paragraph(s, i, c) for i, c in enumerate(s.copies)]
    if s.change is not None:
        out.append(('Effect', _changed(s.change)))
    if s.loose:
        out.append(('Receipts without a packet', [f'{_verdict(r)}.' for r in s.loose]))
    out.append(('Other fixes under way', _others(s)))
    return out


def _fate(s: Story) -> str:
    if s.fate == NOT_SENT:
        return 'was measured and never sent'
    if s.fate == WAITING:
        return 'was measured, and the recording ended before the leader sent it'
    tries = f' {len(s.sent)} times' if len(s.sent) > 1 else ''
    if s.fate == IN_WATER:
        return f'was sent{tries} and still in the water when the recording ended'
    return f'was sent{tries} and never arrived: lost in the water'


def _times(s: Story) -> list[str]:
    """Sentences with the times since the start of the run."""
    out = []
    if s.measured is not None:
        m = s.measured
        out.append(
            f'The array pinged at {_t(s, m.ping_ns)} (t1); the transponder heard it at'
            f' {_t(s, m.heard_ns)} (t2) and replied at {_t(s, m.validity_ns)} (t3, the time of'
            f' validity); the reply was back at {_t(s, m.return_ns)} (t4).'
        )
    elif s.validity_ns is not None:
        out.append(f'Valid at {_t(s, s.validity_ns)} (t3); the ping is not in the bag.')
    for p in s.sent:
        out.append(f'Sent at {_t(s, p.transmit_ns)} as packet {p.order}.')
    if not s.sent and s.copies:
        out.append(f'Sent at {_t(s, s.copies[0].packet.transmit_ns)}, by the packet itself.')
    out += [f'Received at {_t(s, c.packet.receive_ns)}.' for c in s.copies]
    if s.fate != ARRIVED and s.expected_ns is not None:
        out.append(
            f'It was to be expected at about {_t(s, s.expected_ns)}; the recording ends at'
            f' {_t(s, s.end_ns)}.'
        )
    return out


def _delays(s: Story) -> list[str]:
    counted = [leg for leg in s.legs if leg.counted]
    total = sum(leg.seconds for leg in counted)
    arrived = s.copy is not None and s.broadcast is not None
    out = [f'{leg.name}: {leg.seconds:.3f} s, {leg.how}' for leg in s.legs if not leg.counted]
    out += [
        f'{leg.name}: {leg.seconds:.3f} s'
        + (f' ({100 * leg.seconds / total:.0f} %)' if arrived and total else '')
        + f', {leg.how}'
        for leg in counted
    ]
    if arrived:
        out.append(f'age when received: {total:.3f} s')
    return out or ['Nothing of its way is in the bag.']


def _content(s: Story) -> list[str]:
    b = s.broadcast
    if b is None:
        return []
    out = []
    if s.copy is None or s.copy.packet.broadcast is None:
        fate = 'could read' if s.copies else 'heard'
        out.append(f'Nobody {fate} it; by the bytes that were sent:')
    if isinstance(b, StationReport):
        return [*out, *_station_content(b)]
    latitude, longitude = _geodetic(b.leader_r_e)
    out.append(
        f'I was at {latitude}, {longitude} at t4, 1-sigma {_m(b.leader_sigma_horizontal)} per'
        f' horizontal axis and {_m(b.leader_sigma_vertical)} vertically; heading'
        f' {math.degrees(b.leader_grid_heading) % 360.0:.2f} deg from grid north,'
        f' 1-sigma {math.degrees(b.leader_sigma_heading):.3f} deg.'
    )
    sigma = np.sqrt(np.diagonal(b.r_lf_covariance_G))
    out.append(
        f'You were {_vector(b.r_lf_G)} of me at t3, 1-sigma {_three(sigma)} m (east, north, up);'
        f' sound speed {b.sound_speed:.1f} m/s.'
    )
    return out


def _station_content(b: StationReport) -> list[str]:
    bearing = math.degrees(b.bearing)
    return [
        f'I was {_vector(b.station_position)} of where I was first, at t4; heading psi'
        f' {math.degrees(b.station_heading):.2f} deg counter-clockwise from grid east, 1-sigma'
        f' {math.degrees(b.station_heading_sigma):.3f} deg.',
        f'You were {b.range:.1f} m away at t3, {abs(bearing):.1f} deg to'
        f' {"port" if bearing >= 0.0 else "starboard"} of my heading; sound speed'
        f' {b.sound_speed:.0f} m/s.',
    ]


def _sender(s: Story) -> str:
    return 'station' if isinstance(s.broadcast, StationReport) else 'leader'


def _estimated(b: Belief) -> list[str]:
    known = math.isfinite(b.error)
    out = [
        f'Its own position then, 1-sigma {_three(b.sigma)} m (east, north, up)'
        + (f'; truly {_m(b.error)} off.' if known else '.')
    ]
    if np.isfinite(b.difference).all():
        out.append(
            f'The fix lay {_vector(b.difference)} of that, 1-sigma {_three(b.fix_sigma)} m'
            + (
                f'; the fix itself was {_m(b.fix_error)} off.'
                if math.isfinite(b.fix_error)
                else '.'
            )
        )
    return out


def _copy_paragraph(s: Story, index: int, c: Copy) -> Paragraph:
    title = 'Receipt'
    if len(s.copies) > 1:
        title = f'Copy {index + 1} of {len(s.copies)}: packet {c.packet.order}'
    out = []
    if c.damage is not None:
        out += _damaged(c.damage)
    if c.packet.problem and c.damage is None:
        out.append(f'Its bytes cannot be read: {c.packet.problem}.')
    if not c.receipts:
        out.append('There is no receipt of it in the bag.')
    for r in c.receipts:
        out += _receipt(r)
    return title, out


def _receipt(r: ReceiptRecord) -> list[str]:
    first = 'Verdict' if r.revision == 0 else f'Revision {r.revision}'
    out = [f'{first}: {_verdict(r)}.']
    if np.isfinite(r.innovation_G).all():
        measured = r.axes
        axes = ', '.join(name for name, there in zip(_AXES, measured, strict=True) if there)
        out.append(
            f'Innovation {_three(r.innovation_G[measured], signed=True)} m ({axes}), its 1-sigma'
            f' {_three(np.sqrt(r.innovation_variance_G[measured]))} m.'
        )
    if math.isfinite(r.nis) and r.degrees_of_freedom > 0:
        gate = f'the gate is {r.gate:.1f}' if math.isfinite(r.gate) else 'there is no gate'
        out.append(
            f'NIS {r.nis:.2f} with {r.degrees_of_freedom} degrees of freedom, so'
            f' {r.nis / r.degrees_of_freedom:.2f} of what is expected; {gate}.'
        )
        steps = f', {r.steps_rolled_back} filter steps back' if r.steps_rolled_back else ''
        how = _HANDLING.get(r.delay_handling, '')
        out.append(f'Delay handling {r.delay_handling}{steps}' + (f': {how}.' if how else '.'))
    return out


def _verdict(r: ReceiptRecord) -> str:
    return f'{r.verdict_text}, {r.reason}' if r.reason else r.verdict_text


def _damaged(d: Damage) -> list[str]:
    out = []
    if d.computed != d.stated:
        out.append(
            f'CRC-16 of the {len(d.received)} bytes as received is {d.computed:#06x},'
            f' the packet states {d.stated:#06x}.'
        )
    if d.bits is None:
        out.append('The sent packet is not in the bag, so the wrong bits are not known.')
        return out
    names = f', in {", ".join(d.fields)}' if d.fields else ''
    where = ', '.join(str(i) for i in d.differing)
    out.append(
        f'{_count(d.bits, "bit")} of {8 * len(d.received)} came flipped (byte {where}{names}).'
    )
    if d.sent is not None:
        out.append(f'sent     {_hex(d.sent, d.differing)}')
        out.append(f'received {_hex(d.received, d.differing)}')
    return out


def _changed(c: Change) -> list[str]:
    apart = (c.after_ns - c.before_ns) * 1e-9
    out = [
        f'Position moved {_vector(c.shift)}, velocity by'
        f' {_three(1e3 * c.velocity_shift, signed=True)} mm/s, between two estimates {apart:.2f} s'
        ' apart, motion taken out of the position.',
        f'2-D sigma {_m(c.sigma_before)} before, {_m(c.sigma_after)} after.',
    ]
    if math.isfinite(c.error_before) and math.isfinite(c.error_after):
        word = 'better' if c.error_after < c.error_before else 'worse'
        out.append(
            f'True 2-D error {_m(c.error_before)} before, {_m(c.error_after)} after: {word}.'
        )
    if c.also:
        out.append(f'Fixes {", ".join(map(str, c.also))} were used between these two as well.')
    return out


def _others(s: Story) -> list[str]:
    if not s.others:
        return ['No other fix was under way.']
    mine = s.copy.packet.receive_ns if s.copy is not None else None
    out = []
    for o in s.others[:8]:
        order = ''
        if mine is not None and s.validity_ns is not None and o.receive_ns is not None:
            if o.validity_ns > s.validity_ns and o.receive_ns < mine:
                order = ': newer, and there first'
            elif o.validity_ns < s.validity_ns and o.receive_ns > mine:
                order = ': older, and there later'
        received = '' if o.receive_ns is None else f', received at {_t(s, o.receive_ns)}'
        out.append(
            f'Fix {o.sequence} was under way too (valid {_t(s, o.validity_ns)}{received},'
            f' {o.verdict}){order}.'
        )
    if len(s.others) > 8:
        out.append(f'{len(s.others) - 8} more were under way.')
    return out


def _t(s: Story, stamp_ns: int) -> str:
    """Text of a time since the start of the run [s]."""
    return f'{(stamp_ns - s.zero_ns) * 1e-9:.3f} s'


def _m(value: float) -> str:
    """Text of a length in metres, three digits after the point below 10 m."""
    if not math.isfinite(value):
        return 'unknown'
    return f'{value:.3f} m' if abs(value) < 10.0 else f'{value:.1f} m'


def _three(values: np.ndarray, *, signed: bool = False) -> str:
    sign = '+' if signed else ''
    return ', '.join(f'{v:{sign}.3f}' if abs(v) < 100 else f'{v:{sign}.1f}' for v in values)


def _vector(v_G: np.ndarray) -> str:
    """Text of a vector: ``3.20 m grid east, 0.10 m grid north, 0.02 m down``."""
    words = (('grid east', 'grid west'), ('grid north', 'grid south'), ('up', 'down'))
    return ', '.join(
        f'{_m(abs(float(v)))} {pair[0] if v >= 0.0 else pair[1]}'
        for v, pair in zip(v_G, words, strict=True)
    )


def _geodetic(r_e: np.ndarray) -> tuple[str, str]:
    from polar_nav_core.earth import geodetic_from_ecef

    latitude, longitude, _ = (float(v) for v in geodetic_from_ecef(r_e))
    ns, ew = ('N' if latitude >= 0.0 else 'S'), ('E' if longitude >= 0.0 else 'W')
    return f'{abs(math.degrees(latitude)):.6f} {ns}', f'{abs(math.degrees(longitude)):.6f} {ew}'


def _hex(data: bytes, marked: tuple[int, ...]) -> str:
    """Text of bytes in hexadecimal, the marked ones in brackets."""
    return ' '.join(f'[{b:02x}]' if i in marked else f'{b:02x}' for i, b in enumerate(data))


def _count(number: int, what: str) -> str:
    return f'{number} {what}' + ('' if number == 1 else 's')
