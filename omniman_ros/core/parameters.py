"""Parameters declared once: frozen dataclasses whose fields carry unit, range and text.

A group is a frozen dataclass of :func:`parameter` fields; a set of parameters is a dataclass of
groups, nested to any depth. Names are the field names joined by dots. A field `tuple[Group, ...]`
holds groups of one kind: each of its parameters is an array with one value for all of them or one
for each, and the group's first parameter has one for each. The same declaration gives the
validation in the constructor (:class:`~omniman_ros.core.validated.Validated`), the ROS descriptors
(`nodes/parameters.py`), the tables of the documentation and the check of YAML files for mistyped
names.
"""

import contextlib
import dataclasses
import math
import numbers
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from omniman_ros.core.errors import InputError, OmnimanError, ParameterError

T = TypeVar("T")

#: Numbers, numpy's among them, that become one of Python's types
_NUMBERS: Mapping[type, Any] = {int: numbers.Integral, float: numbers.Real}
#: Default of a parameter whose value the robot's configuration file must give
REQUIRED: Any = dataclasses.MISSING

#: Types of the fields of a dataclass, resolved once: that takes longer than all else here
hints_of: Callable[[type], Mapping[str, Any]] = cache(typing.get_type_hints)


@dataclass(frozen=True)
class Place:
    """A field of an object, for the error of a value that is refused."""

    name: str  #: Full name
    is_parameter: bool = False  #: Whether its object is a group of parameters

    def refusal(self, value: Any, reason: str, at: str = "") -> OmnimanError:
        """Return the error; `at` is what follows the field's name, such as an index."""
        if self.is_parameter:
            return ParameterError(self.name + at, value, reason)
        return InputError(f"{self.name}{at} = {value!r} is refused: {reason}")


@dataclass(frozen=True, kw_only=True)
class Range:
    """Declaration of a number, or of a tuple of them, of a data object.

    It stands in the type of the field: `speed: Annotated[float, Range(low=0, unit="m/s")]`.
    """

    unit: str = ""  #: Unit as text
    low: float | None = None  #: Smallest value
    high: float | None = None  #: Largest value
    finite: bool = True  #: Whether infinity and NaN are refused


@dataclass(frozen=True)
class Spec:
    """Declaration of one value: of a parameter, or of a number or word of a data object."""

    name: str  #: Full name, groups joined by dots
    kind: type  #: Python type: bool, int, float, str, or tuple for an array
    item: type | None = None  #: Type of an array's items, else None
    default: Any = None  #: Default value, or REQUIRED
    unit: str = ""  #: Unit as text, empty for pure numbers and words
    low: float | None = None  #: Smallest value, or smallest item; None if there is no bound
    high: float | None = None  #: Largest value, or largest item; None if there is no bound
    choices: tuple[str, ...] = ()  #: Allowed words, or empty
    read_only: bool = False  #: Whether it is fixed once the node runs
    doc: str = ""  #: Description in one sentence
    size: int | None = None  #: Number of items of an array, None if it may have any
    finite: bool = True  #: Whether infinity and NaN are refused
    is_parameter: bool = True  #: Whether a refusal is a ParameterError, not an InputError

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is REQUIRED

    def check(self, value: Any) -> Any:
        """Return the value in its own type: numpy's scalars as Python's, arrays as a tuple.

        Raises:
            ParameterError: The value has the wrong type or size, is not finite, is out of range,
                or is not among the choices; an InputError if it is no parameter.
        """
        if self.item is None:
            return self._check_scalar(value, self.kind)
        if isinstance(value, (str, bytes, Mapping, Set)) or not isinstance(value, Iterable):
            raise self._refusal(value, f"expected an array of {self.item.__name__}")
        try:
            items = tuple(value)
        except TypeError:  # an array of numpy without dimensions
            raise self._refusal(value, f"expected an array of {self.item.__name__}") from None
        if self.size is not None and len(items) != self.size:
            raise self._refusal(items, f"has {len(items)} values, expected {self.size}")
        return tuple([self._check_scalar(item, self.item) for item in items])

    def _check_scalar(self, value: Any, kind: type) -> Any:
        """Check a value, or one item of an array; see :meth:`check`."""
        if type(value) is not kind:
            value = self._converted(value, kind)
        if kind is float or kind is int:
            if self.finite and kind is float and not math.isfinite(value):
                raise self._refusal(value, "not a finite number")
            unit = f" {self.unit}" if self.unit else ""
            if self.low is not None and value < self.low:
                raise self._refusal(value, f"below the minimum {self.low:g}{unit}")
            if self.high is not None and value > self.high:
                raise self._refusal(value, f"above the maximum {self.high:g}{unit}")
        if self.choices and value not in self.choices:
            raise self._refusal(value, f"expected one of {', '.join(self.choices)}")
        return value

    def _converted(self, value: Any, kind: type) -> Any:
        """Return a value of another type, such as numpy's, in Python's own."""
        if kind is str and isinstance(value, str):
            return str.__str__(value)
        # numpy's own, which is not imported here: the command line's help does without it.
        if kind is bool and str(getattr(value, "dtype", "")) == "bool" and not value.shape:
            return bool(value)
        if isinstance(value, _NUMBERS.get(kind, ())) and not isinstance(value, bool):
            with contextlib.suppress(OverflowError):  # an integer beyond all floats
                return kind(value)
        raise self._refusal(value, f"expected {kind.__name__}, got {type(value).__name__}")

    def _refusal(self, value: Any, reason: str) -> OmnimanError:
        return Place(self.name, self.is_parameter).refusal(value, reason)


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
    hints = hints_of(cls)
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
        spec = declared(prefix + entry.name, hint, entry.metadata)
        found.append(dataclasses.replace(spec, default=entry.default))
    return tuple(found)


def declared(name: str, hint: Any, metadata: Mapping[str, Any]) -> Spec:
    """Return the declaration of a field that is a number, a word, a switch or a tuple of them."""
    items = typing.get_args(hint)
    size = None if items[-1:] in ((), (...,)) else len(items)
    item = items[0] if items else None
    return Spec(name, tuple if item else hint, item, size=size, **metadata)


def build(cls: type[T], values: Mapping[str, Any], prefix: str = "") -> T:
    """Build a parameter set from names and values; absent parameters get their defaults.

    Args:
        values: Full parameter names to values; names of other sets are ignored.
        prefix: Prefix of the names, ending in a dot; empty at the top.

    Raises:
        ParameterError: A value is refused, a required one is absent, or the set's own
            `__post_init__` refuses the combination.
    """
    hints = hints_of(cls)
    arguments: dict[str, Any] = {}
    for entry in dataclasses.fields(cls):  # type: ignore[arg-type]
        hint = hints[entry.name]
        name = prefix + entry.name
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            arguments[entry.name] = build(hint, values, _group_prefix(entry, prefix))
        elif several := _group_of_several(hint):
            arguments[entry.name] = _build_several(several, values, _group_prefix(entry, prefix))
        elif name in values:
            arguments[entry.name] = values[name]
        elif entry.default is REQUIRED:
            raise ParameterError(name, None, "has no default: the robot's file must give it")
    with renamed(cls, prefix):
        return cls(**arguments)


@contextlib.contextmanager
def renamed(cls: type, prefix: str) -> Iterator[None]:
    """Within, an error of a class's constructor names the parameter by a prefix, not the class."""
    try:
        yield
    except ParameterError as error:
        own = f"{cls.__name__}."
        if not error.name.startswith(own):
            raise
        name = prefix + error.name.removeprefix(own)
        raise ParameterError(name, error.value, error.reason) from None


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
