import math
from dataclasses import dataclass

import pytest

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.errors import OmnimanError, ParameterError
from omniman_ros.core.parameters import (
    REQUIRED,
    build,
    flatten,
    flatten_mapping,
    inline,
    parameter,
    specs,
)
from omniman_ros.core.validated import Validated
from test.robots import ALL, parameters, robot


@dataclass(frozen=True)
class Inner(Validated):
    gain: float = parameter(2.0, "A gain.", unit="1/s", low=0, high=10)
    mode: str = parameter("slow", "A word.", choices=("slow", "fast"))


@dataclass(frozen=True, kw_only=True)
class Outer(Validated):
    first: Inner
    second: Inner = inline()
    count: int = parameter(REQUIRED, "A count.", low=1, high=8, read_only=True)
    names: tuple[str, ...] = parameter((), "Words.")
    sizes: tuple[float, ...] = parameter((1.0,), "Sizes.", unit="m", low=0)
    on: bool = parameter(True, "A switch.")


def test_specs_list_all_parameters_by_full_name_in_declaration_order():
    found = {spec.name: spec for spec in specs(Outer)}
    assert list(found) == [
        "first.gain",
        "first.mode",
        "gain",
        "mode",
        "count",
        "names",
        "sizes",
        "on",
    ]
    gain = found["first.gain"]
    assert (gain.kind, gain.item, gain.default, gain.unit) == (float, None, 2.0, "1/s")
    assert (gain.low, gain.high, gain.read_only, gain.required) == (0, 10, False, False)
    assert gain.doc == "A gain."
    assert found["first.mode"].choices == ("slow", "fast")
    assert found["count"].required
    assert found["count"].read_only
    assert (found["sizes"].kind, found["sizes"].item) == (tuple, float)


def test_build_uses_defaults_and_ignores_other_names():
    made = build(Outer, {"count": 3, "gain": 5, "first.mode": "fast", "elsewhere": object()})
    assert made == Outer(first=Inner(2.0, "fast"), second=Inner(5.0), count=3)
    assert isinstance(made.second.gain, float)


def test_flatten_is_the_inverse_of_build():
    values = {"count": 3, "gain": 5.0, "names": ("a", "b"), "on": False}
    flat = flatten(build(Outer, values))
    assert flat["names"] == ("a", "b")
    assert set(flat) == {spec.name for spec in specs(Outer)}
    assert flatten(build(Outer, flat)) == flat


@pytest.mark.parametrize("name", ALL)
def test_platform_parameters_survive_a_round_trip(name):
    made = parameters(name)
    flat = flatten(made)
    assert set(flat) == {spec.name for spec in specs(PlatformParameters)}
    assert build(PlatformParameters, flat) == made


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("gain", "5", "expected float, got str"),
        ("gain", True, "expected float, got bool"),
        ("gain", None, "expected float, got NoneType"),
        ("gain", math.nan, "not a finite number"),
        ("gain", math.inf, "not a finite number"),
        ("gain", -0.1, "below the minimum 0 1/s"),
        ("gain", 10.1, "above the maximum 10 1/s"),
        ("first.gain", [1.0], "expected float, got list"),
        ("mode", "Fast", "expected one of slow, fast"),
        ("mode", 1, "expected str, got int"),
        ("count", 2.0, "expected int, got float"),
        ("count", True, "expected int, got bool"),
        ("count", 9, "above the maximum 8"),
        ("on", 1, "expected bool, got int"),
        ("names", "ab", "expected an array of str"),
        ("names", [1], "expected str, got int"),
        ("sizes", 1.0, "expected an array of float"),
        ("sizes", [1, -1], "below the minimum 0 m"),
        ("sizes", [math.nan], "not a finite number"),
    ],
)
def test_invalid_value_is_rejected_with_name_value_unit_and_limit(name, value, why):
    with pytest.raises(ParameterError) as caught:
        build(Outer, {"count": 1, name: value})
    assert caught.value.name == name
    assert why in str(caught.value)
    assert repr(name) in str(caught.value)
    assert isinstance(caught.value, (OmnimanError, ValueError))


def test_values_at_the_limits_are_allowed():
    made = build(Outer, {"count": 8, "gain": 0, "first.gain": 10})
    assert (made.second.gain, made.first.gain) == (0.0, 10.0)


def test_parameters_without_default_are_required():
    with pytest.raises(ParameterError, match=r"'count'.*no default"):
        build(Outer, {})
    with pytest.raises(ParameterError, match="no default"):
        build(PlatformParameters, {})


def test_nested_mappings_are_flattened():
    tree = {"wheels": {"x": [1, 2], "more": {"deep": 1}}, "mu": 0.5}
    assert flatten_mapping(tree) == {"wheels.x": [1, 2], "wheels.more.deep": 1, "mu": 0.5}


def test_every_parameter_has_a_description_of_its_own():
    found = specs(PlatformParameters)
    assert len(found) > 60
    for spec in found:
        assert spec.doc[0].isupper(), spec.name
        assert spec.doc.endswith("."), spec.name


def test_defaults_are_within_their_limits():
    for spec in specs(PlatformParameters):
        if not spec.required:
            assert spec.check(spec.default) == spec.default


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"odometry.wheel_scale": [1.0, 1.0]}, "odometry.wheel_scale"),
        ({"drive.offered": ["torque"]}, "drive.offered"),
        ({"drive.offered": ["velocity"], "drive.mode": "torque"}, "drive.mode"),
        ({"wheels.radius": [0.1, 0.1]}, "wheels.radius"),
        ({"friction.coulomb": [0.1] * 5}, "friction.coulomb"),
        ({"wheels.x": [0.1]}, "wheels.x"),
        ({"wheels.names": ["a", "b"]}, "wheels.names"),
        ({"wheels.names": ["a", "b", "c", "a"]}, "wheels.names"),
        ({"wheels.names": ["a", "b", "c", ""]}, "wheels.names"),
        ({"motor.gear_efficiency": 1.5}, "motor.gear_efficiency"),
        ({"limits.linear_jerk": 0.0}, "limits.linear_jerk"),
    ],
)
def test_inconsistent_values_are_rejected(changes, name):
    with pytest.raises(ParameterError) as caught:
        parameters("omniman", changes)
    assert caught.value.name == name


def test_single_value_applies_to_all_wheels():
    made = robot("omniman", {"friction.coulomb": [0.1, 0.2, 0.3, 0.4]})
    assert made.wheels.radius == (0.127,) * 4
    assert made.friction.coulomb == (0.1, 0.2, 0.3, 0.4)
    assert made.friction.viscous == (0.05,) * 4


@dataclass(frozen=True, kw_only=True)
class Lamp:
    name: str = parameter("lamp", "Name.", read_only=True)
    height: float = parameter(2.0, "Height.", unit="m", low=0, high=5)
    color: str = parameter("red", "Color.", choices=("red", "green"))
    on: bool = parameter(True, "Whether it is lit.")


@dataclass(frozen=True, kw_only=True)
class Room:
    lamps: tuple[Lamp, ...]


def test_several_groups_of_a_kind_are_declared_as_arrays():
    found = {spec.name: spec for spec in specs(Room)}
    assert list(found) == ["lamps.name", "lamps.height", "lamps.color", "lamps.on"]
    height = found["lamps.height"]
    assert (height.kind, height.item, height.default) == (tuple, float, (2.0,))
    assert (height.unit, height.low, height.high) == ("m", 0, 5)
    assert found["lamps.name"].read_only


def test_several_groups_have_one_value_for_all_or_one_each():
    assert build(Room, {}) == Room(lamps=(Lamp(),))
    values = {"lamps.name": ["a", "b"], "lamps.height": [1, 3.0], "lamps.color": ["green"]}
    room = build(Room, values)
    assert room.lamps == (
        Lamp(name="a", height=1.0, color="green"),
        Lamp(name="b", height=3.0, color="green"),
    )
    assert build(Room, flatten(room)) == room


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"lamps.height": [1.0, 2.0, 3.0]}, r"lamps\.height.*one value or 2.*lamps\.name"),
        ({"lamps.height": []}, r"lamps\.height"),
        ({"lamps.height": [1.0, 9.0]}, r"lamps\.height.*5 m"),
        ({"lamps.height": 1.0}, r"lamps\.height.*array"),
        ({"lamps.color": ["red", "blue"]}, r"lamps\.color.*red, green"),
        ({"lamps.on": [1, 0]}, r"lamps\.on.*bool"),
        ({"lamps.name": []}, r"lamps\.name"),
    ],
)
def test_a_value_of_several_groups_that_does_not_fit_is_refused(change, name):
    with pytest.raises(ParameterError, match=name):
        build(Room, {"lamps.name": ["a", "b"]} | change)
