"""The base of dataclasses whose constructor refuses what their fields do not declare."""

import dataclasses
import types
import typing
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, Self

import numpy as np

from omniman_ros.core.arrays import Shape
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import Place, Range, declared, hints_of

#: Types of the values that a :class:`~omniman_ros.core.parameters.Spec` checks
SCALARS = (bool, int, float, str)

Check = Callable[[Any, dict[str, Any]], Any]


class Validated:
    """A frozen dataclass whose constructor checks and normalises its fields.

    A field is checked by its declaration, :func:`~omniman_ros.core.parameters.parameter`,
    :class:`~omniman_ros.core.parameters.Range` or :class:`~omniman_ros.core.arrays.Shape`, and by
    its type: numbers without a Range must be finite, objects must be of their class. numpy's
    scalars and integers become Python's floats, sequences become tuples, arrays become read-only
    copies unless nobody can write them. A subclass that compares fields calls this
    `__post_init__` first.

    Raises:
        ParameterError: A parameter or a group of parameters is refused.
        InputError: Another field is refused.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        sizes: dict[str, Any] = {}
        for name, check in checks_of(type(self)):
            given = getattr(self, name)
            value = check(given, sizes)
            if value is not given:
                object.__setattr__(self, name, value)

    @classmethod
    def unchecked(cls, **fields: Any) -> Self:
        """Return an object of all its fields without any check, a tenth of the time.

        For code that makes many objects a cycle from what it has just computed. Arrays become
        read-only, and are not copied.
        """
        made = object.__new__(cls)
        for value in fields.values():
            if type(value) is np.ndarray:
                value.setflags(write=False)
        made.__dict__.update(fields)
        return made

    def _refusal(self, name: str, reason: str) -> ParameterError:
        """Return the error of a parameter that does not go with the others."""
        value: Any = self
        for part in name.split("."):
            value = getattr(value, part)
        return ParameterError(f"{type(self).__name__}.{name}", value, reason)


def _checks(cls: type) -> tuple[tuple[str, Check], ...]:
    """Return the names of a class's checked fields, and their checks, in order."""
    hints, is_parameter = typing.get_type_hints(cls, include_extras=True), _has_parameters(cls)
    found = []
    for entry in dataclasses.fields(cls):
        if not entry.init:
            continue
        place = Place(f"{cls.__name__}.{entry.name}", is_parameter)
        check = _check_of(place, hints[entry.name], entry.metadata)
        if check is not None:
            found.append((entry.name, check))
    return tuple(found)


#: Checks of a class, made once
checks_of: Callable[[type], tuple[tuple[str, Check], ...]] = cache(_checks)


def _has_parameters(kind: Any) -> bool:
    """Return whether a class, or one of those in a tuple, is a group of parameters."""
    if typing.get_origin(kind) is tuple:
        return any(map(_has_parameters, typing.get_args(kind)))
    return (
        isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
        and any(
            "doc" in entry.metadata or _has_parameters(hints_of(kind)[entry.name])
            for entry in dataclasses.fields(kind)
        )
    )


def _check_of(place: Place, hint: Any, declaration: Any = None) -> Check | None:
    """Return the check of a field, or of the items of one; None if its type tells nothing.

    Args:
        declaration: The Shape, Range or parameter's metadata that goes with the type.
    """
    if typing.get_origin(hint) is Annotated:
        hint, declaration = typing.get_args(hint)[:2]
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _check_of_union(place, arguments, declaration)
    if origin is np.ndarray:
        if not isinstance(declaration, Shape):
            raise TypeError(f"the array {place.name} needs a Shape in its type")
        return declaration.of(place, np.dtype(typing.get_args(arguments[1])[0])).check
    is_tuple_of_scalars = origin is tuple and len(set(arguments) - {...}) == 1
    if hint in SCALARS or (is_tuple_of_scalars and arguments[0] in SCALARS):
        metadata = vars(declaration) if isinstance(declaration, Range) else declaration or {}
        spec = declared(place.name, hint, {**metadata, "is_parameter": place.is_parameter})
        return lambda value, _sizes: spec.check(value)
    if origin is tuple:
        return _check_of_tuple(place, arguments)
    if isinstance(hint, type) and not getattr(hint, "_is_protocol", False):
        return _check_of_class(place, (hint,))
    return None


def _check_of_union(place: Place, arguments: tuple[Any, ...], declaration: Any) -> Check | None:
    """Return the check of `X | None`, or of several classes."""
    kinds = tuple(kind for kind in arguments if kind is not types.NoneType)
    if len(kinds) == 1:
        check = _check_of(place, kinds[0], declaration)
        return check and (lambda value, sizes: None if value is None else check(value, sizes))
    if all(isinstance(kind, type) and typing.get_origin(kind) is None for kind in arguments):
        return _check_of_class(place, arguments)
    return None


def _check_of_tuple(place: Place, arguments: tuple[Any, ...]) -> Check | None:
    """Return the check of a tuple of objects."""
    size = None if arguments[-1:] == (...,) else len(arguments)
    each = [_check_of(place, hint) for hint in arguments if hint is not ...]

    def check(value: Any, sizes: dict[str, Any]) -> tuple[Any, ...]:
        if not isinstance(value, (tuple, list)) or size not in (None, len(value)):
            raise place.refusal(value, f"expected a tuple{'' if size is None else f' of {size}'}")
        several = each * len(value) if size is None else each
        items = zip(value, several, strict=True)
        return tuple([item if one is None else one(item, sizes) for item, one in items])

    return check


def _check_of_class(place: Place, kinds: tuple[type, ...]) -> Check:
    """Return the check that a value is an instance of one of the classes."""

    def check(value: Any, _sizes: dict[str, Any]) -> Any:
        if not isinstance(value, kinds):
            names = " or ".join(kind.__name__ for kind in kinds)
            raise place.refusal(value, f"expected {names}, got {type(value).__name__}")
        return value

    return check
