"""Parameter sets of the core as ROS parameters: declared, described, validated, live."""

import difflib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from omniman_ros.core.errors import OmnimanError, ParameterError
from omniman_ros.core.parameters import Spec, build, specs
from omniman_ros.nodes.registry import known_names
from omniman_ros.robots import load_robot

T = TypeVar("T")

_TYPES = {
    (bool, None): Parameter.Type.BOOL,
    (int, None): Parameter.Type.INTEGER,
    (float, None): Parameter.Type.DOUBLE,
    (str, None): Parameter.Type.STRING,
    (tuple, float): Parameter.Type.DOUBLE_ARRAY,
    (tuple, str): Parameter.Type.STRING_ARRAY,
    (tuple, int): Parameter.Type.INTEGER_ARRAY,
}
_UNBOUNDED = 1e300


def descriptor(spec: Spec) -> ParameterDescriptor:
    """What `ros2 param describe` shows of a parameter."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    result = ParameterDescriptor(
        name=spec.name, description=spec.doc + unit, read_only=spec.read_only
    )
    if spec.choices:
        result.additional_constraints = "one of: " + ", ".join(spec.choices)
    low, high = spec.low, spec.high
    if spec.item is not None and (low is not None or high is not None):
        result.additional_constraints = f"each from {low} to {high}"
    elif spec.kind is int and low is not None and high is not None:
        result.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
    elif spec.kind is float and (low is not None or high is not None):
        bounds = FloatingPointRange(
            from_value=float(-_UNBOUNDED if low is None else low),
            to_value=float(_UNBOUNDED if high is None else high),
            step=0.0,
        )
        result.floating_point_range = [bounds]
    return result


class ParameterSet(Generic[T]):
    """A parameter dataclass of a node, kept in step with its ROS parameters.

    Args:
        node: Where the parameters are declared.
        cls: The dataclass, see `core.parameters`.
        robot: Whether the robot's file gives the defaults. It is named by the parameter `robot`,
            unless the given parameters describe a robot themselves (they have `wheels.names`).

    Attributes:
        value: The current set.

    Raises:
        ParameterError: A value is refused.
    """

    def __init__(self, node: Node, cls: type[T], *, robot: bool = True) -> None:
        self._node = node
        self._cls = cls
        self._apply: Callable[[T], None] | None = None
        self._specs = {spec.name: spec for spec in specs(cls)}
        # rclpy offers no public look at what was given on the command line and in files.
        given: Mapping[str, Any] = node._parameter_overrides
        defaults = self._robot_defaults(given) if robot else {}
        for spec in self._specs.values():
            self._declare(spec, defaults.get(spec.name, spec.default))
        self.value: T = build(cls, self._current())
        node.add_on_set_parameters_callback(self._on_set)
        for sentence in unknown_names(given, known_names()):
            node.get_logger().warning(sentence)

    def on_change(self, apply: Callable[[T], None]) -> None:
        """Call `apply` with the new set at each change; what it raises refuses the change."""
        self._apply = apply

    def _robot_defaults(self, given: Mapping[str, Any]) -> Mapping[str, Any]:
        text = ParameterDescriptor(
            description="The robot: a name in share/omniman_ros/config or the path of a YAML file",
            read_only=True,
        )
        name = self._node.declare_parameter("robot", "omniman", text).value
        if "wheels.names" in given:
            return {}
        values = load_robot(name)
        for sentence in unknown_names(values, known_names()):
            raise ParameterError("robot", name, sentence)
        return values

    def _declare(self, spec: Spec, default: Any) -> None:
        kind = _TYPES[spec.kind, spec.item]
        text = descriptor(spec)
        try:
            if spec.required and default is spec.default or default == ():
                self._node.declare_parameter(spec.name, kind, text)
                return
            value = spec.check(default)
            value = list(value) if isinstance(value, tuple) else value
            self._node.declare_parameter(spec.name, value, text)
        except InvalidParameterTypeException as error:
            kind_name = kind.name.lower().replace("_", " ")
            raise ParameterError(
                spec.name, self._node._parameter_overrides[spec.name].value,
                f"expected a {kind_name} (write 1.0, not 1, for a double)",
            ) from error  # fmt: skip
        except InvalidParameterValueException as error:
            value = self._node._parameter_overrides[spec.name].value
            spec.check(tuple(value) if spec.item else value)
            raise ParameterError(spec.name, value, str(error)) from error

    def _current(self) -> dict[str, Any]:
        parameters = self._node.get_parameters_by_prefix("")
        return {
            name: parameters[name].value
            for name in self._specs
            if name in parameters and parameters[name].type_ is not Parameter.Type.NOT_SET
        }

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        ours = {change.name: change.value for change in changes if change.name in self._specs}
        if not ours:
            return SetParametersResult(successful=True)
        try:
            value = build(self._cls, self._current() | ours)
            if self._apply is not None:
                self._apply(value)
        except OmnimanError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.value = value
        return SetParametersResult(successful=True)


def unknown_names(given: Iterable[str], known: Iterable[str]) -> list[str]:
    """Sentences about given parameter names that no node of the package has.

    rclpy ignores a mistyped name in a file without a word.
    """
    names = {*known, "robot"}
    sentences = []
    for name in sorted(set(given) - names):
        if name.startswith(("use_sim_time", "qos_overrides", "start_type_description_service")):
            continue
        close = difflib.get_close_matches(name, names, 1)
        hint = f", did you mean '{close[0]}'?" if close else ""
        sentences.append(f"no node of omniman_ros has a parameter '{name}'{hint}")
    return sentences
