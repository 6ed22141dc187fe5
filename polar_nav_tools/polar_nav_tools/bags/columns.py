"""Arrays of the fields of many serialized messages, one NumPy array per field.

Messages are read in batches; within a batch all messages of one layout (`layout.py`) are read by
one structured NumPy view, so the cost per message is that of copying its bytes. Messages with
unusual lengths only make more layouts; where a batch has very many, the rest is decoded one by
one, with the same numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from .decode import store_of
from .errors import BagError
from .layout import Layout, Leaf, layout_of

Columns = dict[str, NDArray[Any]]

BATCH = 16_384
_MAX_LAYOUTS = 64
_STEP = re.compile(r'\.?(\w+)|\[(\d+)\]')


def read_columns(
    messages: Iterable[bytes],
    type_name: str,
    text: str,
    fields: Sequence[str],
    *,
    max_layouts: int = _MAX_LAYOUTS,
) -> Columns:
    """Decode some fields of messages of one type.

    Parameters
    ----------
    messages : iterable of bytes
        CDR with encapsulation.
    type_name, text : str
        Type and its ros2msg definition.
    fields : sequence of str
        Paths to numbers, fixed rows of numbers or strings: ``header.stamp.sec``, ``r_e``.
    max_layouts : int
        Layouts per batch before the rest is decoded one by one.

    Returns
    -------
    dict of str to ndarray
        Shape (N,), or (N, k) for rows of k numbers; strings are an array of `str` objects.

    Raises
    ------
    BagError
        If a message is not of that type, a field does not exist, or a row's length varies.
    """
    store = store_of(text, type_name)
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in fields}
    for batch in _batches(messages):
        for name, column in _read_batch(batch, store, type_name, fields, max_layouts).items():
            parts[name].append(column)
    return {name: _joined(name, found) for name, found in parts.items()}


def stamps(columns: Columns, path: str) -> NDArray[np.int64]:
    """Return a time field (needs ``<path>.sec`` and ``<path>.nanosec``) as nanoseconds."""
    seconds = columns[f'{path}.sec'].astype(np.int64)
    return seconds * 1_000_000_000 + columns[f'{path}.nanosec'].astype(np.int64)


def time_fields(path: str) -> tuple[str, str]:
    """Return the paths that `stamps` needs."""
    return f'{path}.sec', f'{path}.nanosec'


def _batches(messages: Iterable[bytes]) -> Iterator[list[bytes]]:
    iterator = iter(messages)
    while batch := list(islice(iterator, BATCH)):
        yield batch


def _joined(name: str, parts: list[NDArray[Any]]) -> NDArray[Any]:
    if not parts:
        return np.empty(0)
    if len({p.shape[1:] for p in parts}) > 1:
        raise BagError(f'field {name} has rows of different length')
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _read_batch(
    batch: list[bytes], store: Typestore, type_name: str, fields: Sequence[str], max_layouts: int
) -> Columns:
    sizes = np.fromiter(map(len, batch), np.int64, len(batch))
    found: list[tuple[NDArray[np.intp], Columns]] = []
    layouts = 0
    for size in np.unique(sizes):
        waiting = np.flatnonzero(sizes == size)
        while len(waiting):
            if layouts >= max_layouts:
                found.append((waiting, _one_by_one(batch, waiting, store, type_name, fields)))
                break
            layouts += 1
            layout = layout_of(store, type_name, batch[waiting[0]])
            view, same = _view(batch, waiting, layout, fields, int(size))
            found.append((waiting[same], _columns(view[same], layout, fields)))
            waiting = waiting[~same]
    return {name: _placed(name, len(batch), found) for name in fields}


def _view(
    batch: list[bytes],
    rows: NDArray[np.intp],
    layout: Layout,
    fields: Sequence[str],
    size: int,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """View of messages of one size through a layout, and a mask of those that have it."""
    names, formats, offsets = ['#encapsulation'], ['V2'], [0]
    for at in layout.lengths:
        names.append(f'#{at}')
        formats.append(f'{layout.order}u4')
        offsets.append(at)
    for name in dict.fromkeys(fields):
        leaf = _leaf(layout.leaves, name)
        names.append(name)
        form = leaf.format if leaf.is_text else layout.order + leaf.format
        formats.append(form if leaf.count is None else f'({leaf.count},){form}')
        offsets.append(leaf.offset)
    dtype = np.dtype({'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': size})
    view = np.frombuffer(b''.join([batch[i] for i in rows]), dtype=dtype)
    same = view['#encapsulation'] == view['#encapsulation'][0]
    for at, length in layout.lengths.items():
        same &= view[f'#{at}'] == length
    return view, same


def _columns(view: NDArray[Any], layout: Layout, fields: Sequence[str]) -> Columns:
    columns: Columns = {}
    for name in fields:
        leaf = layout.leaves[name]
        if leaf.is_text:
            columns[name] = _texts(view[name])
        else:
            columns[name] = view[name].astype(leaf.format)  # native, aligned
    return columns


def _leaf(leaves: Mapping[str, Leaf], name: str) -> Leaf:
    if name not in leaves:
        raise BagError(f'there is no field {name} that could be a column')
    return leaves[name]


def _texts(raw: NDArray[np.void]) -> NDArray[np.object_]:
    if np.all(raw == raw[0]):  # names of frames and the like never change
        return _repeated(_decoded(bytes(raw[0])), len(raw))
    return _objects([_decoded(bytes(r)) for r in raw])


def _decoded(raw: bytes) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise BagError(f'a text in a message is not UTF-8: {raw[:32]!r}') from error


def _repeated(text: str, count: int) -> NDArray[np.object_]:
    column = np.empty(count, object)
    column[:] = text
    return column


def _objects(values: list[Any]) -> NDArray[np.object_]:
    column = np.empty(len(values), object)
    column[:] = values
    return column


def _placed(name: str, count: int, found: list[tuple[NDArray[np.intp], Columns]]) -> NDArray[Any]:
    """Rows of all layouts in the order of the messages."""
    if len(found) == 1:
        return found[0][1][name]
    first = found[0][1][name]
    column = np.empty((count, *first.shape[1:]), first.dtype)
    for rows, columns in found:
        if columns[name].shape[1:] != first.shape[1:]:
            raise BagError(f'field {name} has rows of different length')
        column[rows] = columns[name]
    return column


def _one_by_one(
    batch: list[bytes],
    rows: NDArray[np.intp],
    store: Typestore,
    type_name: str,
    fields: Sequence[str],
) -> Columns:
    leaves = layout_of(store, type_name, batch[rows[0]]).leaves
    formats = {name: _leaf(leaves, name).format for name in fields}
    steps = {name: _STEP.findall(name) for name in fields}
    values: dict[str, list[Any]] = {name: [] for name in fields}
    for i in rows:
        try:
            message = store.deserialize_cdr(batch[i], type_name)
        except Exception as error:  # bytes from a file can fail in any way
            raise BagError(f'a message is no {type_name} ({type(error).__name__})') from error
        for name in fields:
            values[name].append(_leaf_value(message, steps[name]))
    return {name: _column_of(name, values[name], formats[name]) for name in fields}


def _leaf_value(message: Any, steps: list[tuple[str, str]]) -> Any:  # noqa: ANN401 - any field
    for attribute, index in steps:
        message = getattr(message, attribute) if attribute else message[int(index)]
    return message


def _column_of(name: str, values: list[Any], form: str) -> NDArray[Any]:
    if form.startswith('V'):
        return _objects(values)
    try:
        return np.array(values, dtype=form)
    except ValueError as error:
        raise BagError(f'field {name} has rows of different length') from error
