"""Declaration of a parameter dataclass on a node; unknown parameters are refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import NodeParams, from_mapping, unknown_parameter

T = TypeVar('T', bound=NodeParams)

# Names that rclpy declares by itself in every node.
_RCLPY_OWN = ('use_sim_time', 'start_type_description_service')


def load(node: Node, cls: type[T], stated: Mapping[str, Any] | None = None) -> T:
    """Values of the fields of ``cls``, declared on ``node`` read-only with range and text.

    Parameters
    ----------
    node : Node
    cls : type
        Dataclass of parameters.
    stated : mapping, optional
        Defaults other than those of the class; what the node was started with wins.

    Raises
    ------
    ConfigError
        For an unknown name given to the node, a wrong type or a value out of range.
    """
    known = {f.name for f in fields(cls)}
    # The overrides a node was started with stand in a private attribute only; undeclared ones
    # are otherwise silent.
    given = [
        name
        for name in node._parameter_overrides
        if name not in known and not name.startswith(_RCLPY_OWN)
    ]
    unknown = [name for name in given if not name.startswith('qos_overrides.')]
    if unknown:
        raise ConfigError(unknown_parameter(unknown[0], node.get_name(), known))
    values: dict[str, Any] = {}
    for f in fields(cls):
        default = (stated or {}).get(f.name, f.default)
        default = list(default) if isinstance(default, tuple) else default
        if f.metadata['kind'] == 'strs' and not default:
            default = ['']  # rclpy cannot tell the type of an empty list
        try:
            value = node.declare_parameter(f.name, default, _descriptor(f.metadata)).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            given_value = (
                node._parameter_overrides[f.name].value
                if f.name in node._parameter_overrides
                else default
            )
            expected = _expected(f.metadata, given_value)
            raise ConfigError(
                f'parameter {f.name}: {given_value!r} is refused: {expected}'
            ) from error
        if f.metadata['kind'] == 'strs':
            value = [v for v in value if v]
        values[f.name] = list(value) if f.metadata['kind'] in ('floats', 'strs') else value
    return from_mapping(cls, values)


def _expected(meta: Mapping[str, Any], given: object) -> str:
    unit = f' {meta["unit"]}' if meta['unit'] else ''
    if meta['kind'] == 'float':
        hint = ' (write 5.0, not 5)' if isinstance(given, int) else ''
        return f'a float in [{meta["lo"]}, {meta["hi"]}]{unit}{hint}'
    if meta['kind'] == 'int':
        return f'an integer in [{meta["lo"]}, {meta["hi"]}]{unit}'
    if meta['kind'] == 'floats':
        return f'a list of {meta["length"]} floats'
    return {'bool': 'true or false', 'str': 'a text', 'strs': 'a list of texts'}[meta['kind']]


def _descriptor(meta: Mapping[str, Any]) -> ParameterDescriptor:
    unit = f' [{meta["unit"]}]' if meta['unit'] else ''
    about = ParameterDescriptor(description=meta['doc'] + unit, read_only=True)
    if meta['kind'] == 'float':
        about.floating_point_range = [
            FloatingPointRange(from_value=float(meta['lo']), to_value=float(meta['hi']), step=0.0)
        ]
    elif meta['kind'] == 'int':
        about.integer_range = [
            IntegerRange(from_value=int(meta['lo']), to_value=int(meta['hi']), step=1)
        ]
    elif 'options' in meta:
        about.additional_constraints = 'one of ' + ', '.join(meta['options'])
    return about
