"""Constructors of dataclasses refuse nonsense in every field, and freeze their arrays."""

import dataclasses
import importlib
import math
import pkgutil
import types
import typing
from enum import Enum
from functools import cache
from typing import Annotated

import numpy as np

import omniman_ros
from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Shape
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from test.robots import robot, values

#: Rooms whose frozen dataclasses with arrays are checked; parameters are everywhere
ROOMS = ("core", "control", "motion", "planning", "collision", "perception")
ROOMS += ("simulation.plant", "simulation.world")
#: Intermediate results of the search and of a scan's evaluation, which still are unchecked
UNCHECKED = {"Found", "Joints", "Region", "LatticeFrame", "Checked", "Priced"}
UNCHECKED |= {"Scan", "View", "Clusters", "Outlines"}
NONSENSE = [math.nan, math.inf, -1e300, "three", b"3", None, object(), [[1.0], [1.0, 2.0]], {1.0}]


@cache
def dataclasses_of_the_package():
    found = []
    for module in pkgutil.walk_packages(omniman_ros.__path__, "omniman_ros."):
        try:
            content = vars(importlib.import_module(module.name))
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("omniman_ros"):
                raise
            continue  # it needs a library that is not installed here
        found += [
            value
            for value in content.values()
            if isinstance(value, type)
            and dataclasses.is_dataclass(value)
            and value.__module__ == module.name
        ]
    return found


def hints(cls):
    return typing.get_type_hints(cls, include_extras=True)


def has_arrays(cls):
    return any("ndarray" in str(hint) for hint in hints(cls).values())


def is_public_core(cls):
    room = cls.__module__.removeprefix("omniman_ros.")
    is_core = any(room == name or room.startswith(f"{name}.") for name in ROOMS)
    is_left_out = cls.__name__.startswith("_") or cls.__name__ in UNCHECKED
    return is_core and not is_left_out and cls.__dataclass_params__.frozen


def test_every_set_of_parameters_and_every_object_with_arrays_is_validated():
    for cls in dataclasses_of_the_package():
        declares = any("doc" in entry.metadata for entry in dataclasses.fields(cls))
        if declares or (is_public_core(cls) and has_arrays(cls)):
            assert issubclass(cls, Validated), cls


def validated_classes():
    return [cls for cls in dataclasses_of_the_package() if issubclass(cls, Validated)]


#: What an example needs beside what its types say
SPECIAL = {
    "Footprint": lambda: Footprint(Rectangles.around(robot().body)),
    "ArmParameters.joints": lambda: tuple("abcdef"),
    "ArmParameters.lower": lambda: (-1.0,),
    "AxisLimits.names": lambda: tuple("abcd"),
    "WholeBodyLimits.names": lambda: tuple("abcd"),
    "MoveItConfiguration.description": lambda: build(DescriptionParameters, values()),
    "ObstacleTrackerParameters.scanners": lambda: (),
    "SimulatedWorldParameters.scanners": lambda: (),
    "Clutter.x_max": lambda: 3.0,
    "Clutter.y_max": lambda: 3.0,
    "Wall.x": lambda: (0.0, 1.0, 2.0),
    "JointPoints.columns": lambda: (0, 1, 2),
}


def example(name, hint, entry=None):
    """Return a value that a field of a type may have."""
    if name in SPECIAL:
        return SPECIAL[name]()
    if entry is not None and entry.default is not dataclasses.MISSING:
        return entry.default
    if entry is not None and entry.default_factory is not dataclasses.MISSING:
        return entry.default_factory()
    declaration = None
    if typing.get_origin(hint) is Annotated:
        hint, declaration = typing.get_args(hint)[:2]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        hint = typing.get_args(hint)[0]
    arguments = typing.get_args(hint)
    if isinstance(declaration, Shape):
        return example_array(declaration, np.dtype(typing.get_args(arguments[1])[0]))
    if typing.get_origin(hint) is tuple:
        count = 3 if arguments[-1] is ... else len(arguments)
        items = [example("", item) for item in (arguments * count)[:count] if item is not ...]
        items = items * count if arguments[-1] is ... else items
        return tuple(f"{item}{k}" if item == "name" else item for k, item in enumerate(items))[
            :count
        ]
    return example_of_class(hint, {} if entry is None else entry.metadata)


def example_array(declaration, kind):
    sizes = [
        size if size is ... else size[1] + (4 if size[0] else 0) for size in declaration._sizes
    ]
    shape = [size for size in sizes if size is not ...]
    made = np.ones(shape, dtype=kind)
    return np.arange(float(*shape)) if declaration._increasing else made


def example_of_class(hint, metadata):
    if hint in (float, int):
        low, high = metadata.get("low"), metadata.get("high")
        value = 1 if low is None else max(1, low)
        return hint(value if high is None else min(value, high))
    if hint in (str, bool):
        return "name" if hint is str else False
    if hint.__name__ in SPECIAL:
        return SPECIAL[hint.__name__]()
    if issubclass(hint, Enum):
        return next(iter(hint))
    if dataclasses.is_dataclass(hint):
        return hint(**arguments_of(hint))
    return object.__new__(hint) if not getattr(hint, "_is_protocol", False) else None


def arguments_of(cls):
    """Return the arguments of a valid object of a class."""
    types_of = hints(cls)
    return {
        entry.name: example(f"{cls.__name__}.{entry.name}", types_of[entry.name], entry)
        for entry in dataclasses.fields(cls)
        if entry.init
    }


def same(kept, given):
    """Return whether a field has the value that was given, in its own type."""
    if isinstance(kept, np.ndarray) and not kept.size:
        return not np.size(given)
    if isinstance(kept, np.ndarray):
        return np.array_equal(kept, np.broadcast_to(given, kept.shape), equal_nan=True)
    return kept is given or kept == given or (kept != kept and given != given)


def arrays_of(made):
    return [value for value in vars(made).values() if isinstance(value, np.ndarray)]


def nonsense_for(value):
    yield from NONSENSE
    if isinstance(value, np.ndarray):
        yield from (
            value[..., None],
            [*np.ravel(value).tolist(), 7.0],
            value.astype(str),
            1j * value,
        )
        if value.dtype.kind == "f":
            yield from (np.full(value.shape, bad) for bad in (math.nan, -math.inf, -1e300))
    if isinstance(value, tuple) and value:
        yield from ((*value, *value), (math.nan,) * len(value), (None,) * len(value))


def test_constructors_refuse_nonsense_or_keep_what_is_legal():
    tried = refused = named = 0
    for cls in validated_classes():
        arguments = arguments_of(cls)
        valid = cls(**arguments)
        for name in arguments:
            for bad in nonsense_for(getattr(valid, name)):
                tried += 1
                try:
                    made = cls(**{**arguments, name: bad})
                except OmnimanError as error:
                    refused += 1
                    named += f"{cls.__name__}." in str(error)
                else:
                    assert same(getattr(made, name), bad), (cls, name, bad)
    assert tried > 5000 and refused > 0.9 * tried and named > 0.98 * refused


def test_arrays_of_valid_objects_are_read_only():
    seen = 0
    for cls in validated_classes():
        given = arguments_of(cls)
        for array in arrays_of(cls(**given)):
            seen += 1
            assert not array.flags.writeable, cls
        assert all(
            value.flags.writeable for value in given.values() if isinstance(value, np.ndarray)
        )
    assert seen > 100


def test_an_unchecked_object_is_the_same_and_cannot_be_written():
    checked = example_of_class(omniman_ros.Ellipses, {})
    fields = {name: np.array(value) for name, value in vars(checked).items() if name != "time"}
    made = type(checked).unchecked(time=checked.time, **fields)
    assert set(vars(made)) == set(vars(checked))
    for name in fields:
        np.testing.assert_array_equal(getattr(made, name), getattr(checked, name))
        assert not getattr(made, name).flags.writeable
