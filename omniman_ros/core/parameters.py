"""Parameters declared once: frozen dataclasses whose fields carry unit, range and text.

A group is a frozen dataclass of :func:`parameter` fields; a set of parameters is a dataclass of
groups, nested to any depth. Names are the field names joined by dots. A field `tuple[Group, ...]`
holds groups of one kind: each of its parameters is an array with one value for all of them or one
for each, and the group's first parameter has one for each. The same declaration gives the
validation (:func:`build`), the ROS descriptors (`nodes/parameters.py`), the tables of the
documentation and the check of YAML files for mistyped names.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from omniman_ros.core.errors import ParameterError

T = TypeVar("T")

#: Default of a parameter whose value the robot's configuration file must give
REQUIRED: Any = dataclasses.MISSING

#: Types of the fields of a dataclass, resolved once: that takes longer than all else here
_hints: Callable[[type], Mapping[str, Any]] = cache(typing.get_type_hints)


@dataclass(frozen=True)
class Spec:
    """Declaration of one parameter."""

    name: str  #: Full name, groups joined by dots
    kind: type  #: Python type: bool, int, float, str, or tuple for an array
    item: type | None  #: Type of an array's items, else None
    default: Any  #: Default value, or REQUIRED
    unit: str  #: Unit as text, empty for pure numbers and words
    low: float | None  #: Smallest value, or smallest item of an array; None if there is no bound
    high: float | None  #: Largest value, or largest item of an array; None if there is no bound
    choices: tuple[str, ...]  #: Allowed words, or empty
    read_only: bool  #: Whether it is fixed once the node runs
    doc: str  #: Description in one sentence

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is REQUIRED

    def check(self, value: Any) -> Any:
        """Return the value in the parameter's own type.

        Raises:
            ParameterError: The value has the wrong type, is not finite, is out of range, or is
                not among the choices.
        """
        if self.item is None:
            return self._check_scalar(value, self.kind)
        if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
            raise ParameterError(self.name, value, f"expected an array of {self.item.__name__}")
        return tuple(self._check_scalar(item, self.item) for item in value)

    def _check_scalar(self, value: Any, kind: type) -> Any:
        """Check a value, or one item of an array; see :meth:`check`."""
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise ParameterError(
                self.name, value, f"expected {kind.__name__}, got {type(value).__name__}"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(self.name, value, "not a finite number")
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            unit = f" {self.unit}" if self.unit else ""
            if self.low is not None and value < self.low:
                raise ParameterError(self.name, value, f"below the minimum {self.low:g}{unit}")
            if self.high is not None and value > self.high:
                raise ParameterError(self.name, value, f"above the maximum {self.high:g}{unit}")
        if self.choices and value not in self.choices:
            raise ParameterError(self.name, value, f"expected one of {', '.join(self.choices)}")
        return value


def parameter(
    default: Any,
    doc: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
) -> Any:
    """Declare a parameter as a dataclass field; :class:`Spec` explains the arguments."""
    metadata = {
        "doc": doc,
        "unit": unit,
        "low": low,
        "high": high,
        "choices": choices,
        "read_only": read_only,
    }
    return field(default=default, metadata=metadata)


def inline() -> Any:
    """Declare a group whose name is left out of its parameters' names."""
    return field(metadata={"inline": True})


def _group_prefix(entry: "dataclasses.Field[Any]", prefix: str) -> str:
    return prefix if entry.metadata.get("inline") else f"{prefix}{entry.name}."


def _group_of_several(hint: Any) -> type | None:
    """Return the kind of the groups if a field holds several, else None."""
    item = typing.get_args(hint)[0] if typing.get_origin(hint) is tuple else None
    return item if isinstance(item, type) and dataclasses.is_dataclass(item) else None


def specs(cls: type, prefix: str = "") -> list[Spec]:
    """Return the parameters of a dataclass and of its groups, in order of declaration."""
    return list(_specs(cls, prefix))


@cache
def _specs(cls: type, prefix: str) -> tuple[Spec, ...]:
    """Return the parameters of a dataclass; every change of one builds all groups anew."""
    found: list[Spec] = []
    hints = _hints(cls)
    for entry in dataclasses.fields(cls):
        hint = hints[entry.name]
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            found += specs(hint, _group_prefix(entry, prefix))
            continue
        if several := _group_of_several(hint):
            found += [
                dataclasses.replace(spec, kind=tuple, item=spec.kind, default=(spec.default,))
                for spec in specs(several, _group_prefix(entry, prefix))
            ]
            continue
        item = typing.get_args(hint)[0] if typing.get_origin(hint) is tuple else None
        found.append(
            Spec(
                name=prefix + entry.name,
                kind=tuple if item else hint,
                item=item,
                default=entry.default,
                **entry.metadata,
            )
        )
    return tuple(found)


def build(cls: type[T], values: Mapping[str, Any], prefix: str = "") -> T:
    """Build a parameter set from names and values; absent parameters get their defaults.

    Args:
        values: Full parameter names to values; names of other sets are ignored.
        prefix: Prefix of the names, ending in a dot; empty at the top.

    Raises:
        ParameterError: A value is refused, a required one is absent, or the set's own
            `__post_init__` refuses the combination.
    """
    known = {spec.name: spec for spec in specs(cls, prefix)}
    hints = _hints(cls)
    arguments: dict[str, Any] = {}
    for entry in dataclasses.fields(cls):  # type: ignore[arg-type]
        hint = hints[entry.name]
        name = prefix + entry.name
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            arguments[entry.name] = build(hint, values, _group_prefix(entry, prefix))
        elif several := _group_of_several(hint):
            arguments[entry.name] = _build_several(several, values, _group_prefix(entry, prefix))
        elif name in values:
            arguments[entry.name] = known[name].check(values[name])
        elif known[name].required:
            raise ParameterError(name, None, "has no default: the robot's file must give it")
        else:
            arguments[entry.name] = known[name].check(known[name].default)
    return cls(**arguments)


def _build_several(cls: type[T], values: Mapping[str, Any], prefix: str) -> tuple[T, ...]:
    """Build the groups of a field that holds several; see :func:`build`."""
    known = specs(cls, prefix)
    arrays: dict[str, tuple[Any, ...]] = {}
    for spec in known:
        array = dataclasses.replace(spec, kind=tuple, item=spec.kind)
        arrays[spec.name] = array.check(values.get(spec.name, (spec.default,)))
    count = len(arrays[known[0].name])
    for name, array_values in arrays.items():
        if len(array_values) not in (1, count) or not array_values:
            reason = f"must have one value or {count}, one for each of {known[0].name}"
            raise ParameterError(name, array_values, reason)
    return tuple(
        build(cls, {name: array[k % len(array)] for name, array in arrays.items()}, prefix)
        for k in range(count)
    )


def flatten(instance: Any, prefix: str = "") -> dict[str, Any]:
    """Return the full names and values of a parameter set."""
    values: dict[str, Any] = {}
    for entry in dataclasses.fields(instance):
        value = getattr(instance, entry.name)
        if dataclasses.is_dataclass(value):
            values |= flatten(value, _group_prefix(entry, prefix))
        elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            each = [flatten(item, _group_prefix(entry, prefix)) for item in value]
            values |= {name: tuple(item[name] for item in each) for name in each[0]}
        else:
            values[prefix + entry.name] = value
    return values


def flatten_mapping(tree: Mapping[str, Any], prefix: str = "") -> Mapping[str, Any]:
    """Flatten nested mappings, such as a YAML file contains, to full names and values."""
    values: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            values |= flatten_mapping(value, f"{prefix}{key}.")
        else:
            values[f"{prefix}{key}"] = value
    return types.MappingProxyType(values)
