"""Parameter dataclasses as ROS parameters: declared, described, validated and live."""

from array import array
from collections.abc import Callable, Mapping
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
from omniman_ros.nodes.rclpy_compat import parameter_overrides
from omniman_ros.nodes.registry import unknown_names
from omniman_ros.robots import robot_parameters

T = TypeVar("T")

_PARAMETER_TYPES: dict[tuple[type, type | None], Parameter.Type] = {
    (bool, None): Parameter.Type.BOOL,
    (int, None): Parameter.Type.INTEGER,
    (float, None): Parameter.Type.DOUBLE,
    (str, None): Parameter.Type.STRING,
    (tuple, bool): Parameter.Type.BOOL_ARRAY,
    (tuple, float): Parameter.Type.DOUBLE_ARRAY,
    (tuple, str): Parameter.Type.STRING_ARRAY,
    (tuple, int): Parameter.Type.INTEGER_ARRAY,
}  #: Type of a ROS parameter by the Python type of its value and, for a tuple, of its items
_UNBOUNDED = 1e300  #: Bound of a range that is open on one side; descriptors need both


def descriptor(spec: Spec) -> ParameterDescriptor:
    """Return the descriptor of a parameter, which `ros2 param describe` shows."""
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
    """Keeps a parameter dataclass in step with the ROS parameters of a node.

    Args:
        robot: Whether the defaults come from the robot's file. The parameter `robot` names it,
            unless the given parameters describe a robot themselves (they have `wheels.names`).

    Raises:
        ParameterError: A value is refused.
    """

    def __init__(self, node: Node, cls: type[T], *, robot: bool = True) -> None:
        self._node = node
        self._cls = cls
        self._apply: Callable[[T], None] | None = None
        self._specs = {spec.name: spec for spec in specs(cls)}
        self._overrides = parameter_overrides(node)
        self._overrides |= {name: self._as_double(p) for name, p in self._overrides.items()}
        # rclpy takes an empty array for one of bytes, and would refuse it.
        empty = {name for name, given in self._overrides.items() if self._means_none(given)}
        for name in empty:
            del self._overrides[name]
        defaults = self._robot_defaults() if robot else {}
        for spec in self._specs.values():
            default = defaults.get(spec.name, spec.default)
            self._declare(spec, () if spec.name in empty else default)
        self.value: T = build(cls, self._current())
        node.add_pre_set_parameters_callback(self._with_typed_empty_arrays)
        node.add_on_set_parameters_callback(self._on_set)
        for sentence in unknown_names(self._overrides, self._specs):
            node.get_logger().warning(sentence)

    def on_change(self, apply: Callable[[T], None]) -> None:
        """Call `apply` with the new parameters at each change; its error refuses the change."""
        self._apply = apply

    def _robot_defaults(self) -> Mapping[str, Any]:
        """Declare the parameter `robot`, and return the values of that robot's file."""
        robot_descriptor = ParameterDescriptor(
            description="Robot: a name in share/omniman_ros/config or the path of a YAML file",
            read_only=True,
        )
        name = self._node.declare_parameter("robot", "omniman", robot_descriptor).value
        if "wheels.names" in self._overrides:
            return {}
        values = robot_parameters(name)
        for sentence in unknown_names(values, self._specs):
            raise ParameterError("robot", name, sentence)
        return values

    def _declare(self, spec: Spec, default: Any) -> None:
        """Declare a parameter; raise ParameterError for a given value of wrong type or range."""
        kind = _PARAMETER_TYPES[spec.kind, spec.item]
        try:
            if default == ():
                self._declare_empty(spec, kind)
                return
            if spec.required and default is spec.default:
                self._node.declare_parameter(spec.name, kind, descriptor(spec))
                return
            value = spec.check(default)
            value = list(value) if isinstance(value, tuple) else value
            self._node.declare_parameter(spec.name, value, descriptor(spec))
        except InvalidParameterTypeException as error:
            kind_name = kind.name.lower().replace("_", " ")
            raise ParameterError(
                spec.name,
                self._overrides[spec.name].value,
                f"expected a {kind_name}",
            ) from error
        except InvalidParameterValueException as error:
            value = self._overrides[spec.name].value
            spec.check(tuple(value) if spec.item else value)
            raise ParameterError(spec.name, value, str(error)) from error

    def _declare_empty(self, spec: Spec, kind: Parameter.Type) -> None:
        """Declare an array that is empty by default, with a value of its own type.

        A parameter without a value would leave rclpy's answer about all parameters of the node,
        which `ros2 param dump` requests, empty. rclpy takes the default `[]` for an array of
        bytes, so it is set once the type is declared.
        """
        fixed, writable = descriptor(spec), descriptor(spec)
        fixed.type, writable.read_only = kind.value, False
        declared = self._node.declare_parameter(spec.name, kind, writable)
        if declared.type_ is Parameter.Type.NOT_SET:
            self._node.set_parameters([Parameter(spec.name, kind, [])])
        self._node.set_descriptor(spec.name, fixed)

    def _means_none(self, given: Parameter) -> bool:
        """Return whether a given parameter is an array without items.

        `[]` does not tell of what type its items would be: rcl reads it as no value, and
        `ros2 param set` sends an array of booleans. `['']` counts as an empty array as well.
        """
        spec = self._specs.get(given.name)
        if spec is None or spec.item is None:
            return False
        return given.value is None or (
            isinstance(given.value, list | tuple | array) and list(given.value) in ([], [""])
        )

    def _as_double(self, given: Parameter) -> Parameter:
        """Return a given parameter as a double where it is one: ROS reads 1 as an integer."""
        spec = self._specs.get(given.name)
        if spec is not None and spec.kind is float and given.type_ is Parameter.Type.INTEGER:
            return Parameter(given.name, Parameter.Type.DOUBLE, float(given.value))
        is_array = spec is not None and spec.item is float
        if is_array and given.type_ is Parameter.Type.INTEGER_ARRAY:
            return Parameter(given.name, Parameter.Type.DOUBLE_ARRAY, [*map(float, given.value)])
        return given

    def _with_typed_empty_arrays(self, changes: list[Parameter]) -> list[Parameter]:
        """Return changes of parameters, with empty arrays and doubles in the declared type."""
        return [
            Parameter(change.name, _PARAMETER_TYPES[tuple, self._specs[change.name].item], [])
            if change.type_ is not Parameter.Type.NOT_SET and self._means_none(change)
            else self._as_double(change)
            for change in changes
        ]

    def _current(self) -> dict[str, Any]:
        """Return the values of the parameters that are set, by name."""
        # rclpy's annotation says that it returns values, but it returns Parameter objects.
        parameters: dict[str, Any] = self._node.get_parameters_by_prefix("")
        return {
            name: parameters[name].value
            for name in self._specs
            if name in parameters and parameters[name].type_ is not Parameter.Type.NOT_SET
        }

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        """Validate and apply changes, or refuse all of them."""
        values = {change.name: change.value for change in changes if change.name in self._specs}
        if not values:
            return SetParametersResult(successful=True)
        try:
            value = build(self._cls, self._current() | values)
            if self._apply is not None:
                self._apply(value)
        except OmnimanError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.value = value
        return SetParametersResult(successful=True)
