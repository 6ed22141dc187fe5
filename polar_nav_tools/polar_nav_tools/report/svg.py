"""A matplotlib figure as SVG inside a page: themed by CSS variables, small, with tooltips.

matplotlib writes colours, fonts and ids for a stand-alone file. Here colours of `style.TOKENS`
become ``var(--token)``, fonts are left to the page, ids are made unique in the page or dropped,
coordinates are rounded, and single markers get a ``<title>``, which browsers show as a tooltip.
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from .style import TOKENS

_SVG = 'http://www.w3.org/2000/svg'
_XLINK = 'http://www.w3.org/1999/xlink'
_HREF = f'{{{_XLINK}}}href'
_NUMBER = re.compile(r'-?\d+\.\d+(?:e-?\d+)?')
_REFERENCE = re.compile(r'url\(#([^)]+)\)')
_FONT = re.compile(r'font:\s*((?:bold|italic|\d+)\s+)?([\d.]+)px[^;]*')
_FAMILY = re.compile(r'font-family:[^;]*;?\s*')
_VARIABLES = {light: f'var(--{token})' for token, (light, _) in TOKENS.items()}
_IDLE_TURN = re.compile(r'^rotate\(-?0(\.0+)? [^)]*\)$')
_DOT = re.compile(r'M (\S+ \S+) L \1(?= |$)')
_SPACE = re.compile(r'\s+')
_LONG_PATH = 40  # points; beyond, a tenth of a pixel is enough

Tips = Mapping[str, Sequence[str]]


def to_svg(fig: Figure, key: str, label: str, tips: Tips | None = None) -> str:
    """Write the figure as an inline ``<svg>`` element.

    Parameters
    ----------
    fig : Figure
        Drawn inside `style.drawing`.
    key : str
        Prefix of all ids, unique in the page.
    label : str
        Text for screen readers.
    tips : mapping of str to sequence of str
        For an artist with ``set_gid('tips:NAME')``: text of each of its markers, in drawing order.

    Notes
    -----
    An artist with ``set_gid('class:NAME')`` gets ``class="NAME"`` for the style sheet.
    """
    out = io.BytesIO()
    fig.savefig(out, format='svg', facecolor='none', metadata={'Date': None, 'Creator': None})
    root = ET.fromstring(out.getvalue())
    metadata = root.find(f'{{{_SVG}}}metadata')
    if metadata is not None:
        root.remove(metadata)
    width = root.get('viewBox', '0 0 1 1').split()[2]
    for name in ('width', 'height', 'version'):
        root.attrib.pop(name, None)
    root.set('role', 'img')
    root.set('aria-label', label)
    root.set('style', f'--natural: {float(width):.0f}px')
    _add_tips(root, tips or {})
    _clean(root, key)
    ET.register_namespace('', _SVG)
    ET.register_namespace('xlink', _XLINK)
    return ET.tostring(root, encoding='unicode')


def _add_tips(root: ET.Element, tips: Tips) -> None:
    for group in root.iter(f'{{{_SVG}}}g'):
        name = group.get('id', '')
        if not name.startswith('tips:') or name[5:] not in tips:
            continue
        texts = tips[name[5:]]
        marks = list(group.iter(f'{{{_SVG}}}use'))
        if len(marks) != len(texts):
            raise ValueError(
                f'{name}: {len(marks)} markers were drawn, {len(texts)} tooltips given; '
                'draw only finite points inside the axes'
            )
        for mark, text in zip(marks, texts, strict=True):
            ET.SubElement(mark, f'{{{_SVG}}}title').text = text


def _clean(root: ET.Element, key: str) -> None:
    referenced = set()
    for element in root.iter():
        href = element.get(_HREF)
        if href:
            referenced.add(href.lstrip('#'))
        for value in element.attrib.values():
            referenced.update(_REFERENCE.findall(value))
    for element in root.iter():
        name = element.attrib.pop('id', '')
        if name in referenced:
            element.set('id', f'{key}-{name}')
        elif name.startswith('class:'):
            element.set('class', name[6:])
        href = element.attrib.pop(_HREF, None)
        if href:
            element.set('href', f'#{key}-{href[1:]}')
        if _IDLE_TURN.match(element.get('transform', '')):
            element.attrib.pop('transform')
        path = element.get('d')
        if path is not None:
            element.set('d', _short_path(path))
        for attribute in ('x', 'y', 'width', 'height', 'transform', 'points'):
            number = element.get(attribute)
            # A scale needs all its digits.
            if number is not None and 'scale' not in number and 'matrix' not in number:
                element.set(attribute, _rounded(number))
        for attribute, value in list(element.attrib.items()):
            if 'url(#' in value:
                element.set(attribute, _REFERENCE.sub(rf'url(#{key}-\1)', value))
        look = element.get('style')
        if look:
            element.set('style', _themed(look))
        if element.tag == f'{{{_SVG}}}defs' or element.tag == f'{{{_SVG}}}g':
            element.text = element.text if element.text and element.text.strip() else None
        element.tail = None if element.tail is None or not element.tail.strip() else element.tail


def _themed(style: str) -> str:
    """Colours become variables, the font family is left to the page."""
    style = _FAMILY.sub('', _FONT.sub(_font, style))
    for light, variable in _VARIABLES.items():
        style = style.replace(light, variable)
    return style.replace('; ', ';').replace(': ', ':').strip('; ')


def _font(match: re.Match[str]) -> str:
    weight = (match.group(1) or '').strip()
    size = f'font-size:{float(match.group(2)):g}px'
    return f'font-weight:{weight};{size}' if weight else size


def _short_path(path: str) -> str:
    """Same path, shorter: rounded, one space between numbers, repeated letters left out."""
    decimals = 1 if path.count('L') > _LONG_PATH else 2
    text = _DOT.sub(r'M \1 h 0', _SPACE.sub(' ', _rounded(path, decimals).strip()))
    short = []
    last = ''
    for word in text.split(' '):
        if word.isalpha():
            if word == last and word == 'L':
                continue
            last = word
        short.append(word)
    return ' '.join(short)


def _rounded(text: str, decimals: int = 2) -> str:
    """Coordinates to some decimals of a pixel, without trailing zeros."""

    def number(match: re.Match[str]) -> str:
        shown = f'{float(match.group()):.{decimals}f}'.rstrip('0').rstrip('.')
        return '0' if shown == '-0' else shown

    return _NUMBER.sub(number, text)
