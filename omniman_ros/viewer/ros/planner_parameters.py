"""Client of the planner's parameters: reads and sets them through the planner's services."""

import math
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_parameter_events

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.viewer.events import ParameterChanged
from omniman_ros.viewer.view_state import TunableParameter, ViewState

PLANNER = "mpc_planner"  #: Name of the planner's node

PARAMETER_NAMES = (
    "weights.position",
    "weights.heading",
    "weights.velocity",
    "weights.running",
    "weights.energy",
    "safety.clearance",
    "safety.least_clearance",
    "safety.berth",
)  #: Names of the parameters that the page sets, in the order of the page
#: Names of the parameters of the workspace's bounds
WORKSPACE_NAMES = ("workspace.x_min", "workspace.y_min", "workspace.x_max", "workspace.y_max")
ANSWER_TIMEOUT = 4.0  #: Time for which an answer is awaited [s]


class PlannerParameterClient:
    """Reads and sets the planner's parameters without blocking."""

    def __init__(self, node: OmnimanNode, state: ViewState) -> None:
        self._state = state
        self._planner = f"{node.get_namespace().rstrip('/')}/{PLANNER}"
        self._client = AsyncParameterClient(node, PLANNER)
        self._reading: tuple[Any, Any, float] | None = None
        self._setting: tuple[Any, dict[str, float], float] | None = None
        self._requested: dict[str, float] = {}
        self._workspace: dict[str, float] = {}
        node.create_subscription(
            ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events
        )

    def set(self, event: ParameterChanged, now: float) -> None:
        """Set a parameter; of several in quick succession, the last one counts for sure."""
        if event.name not in self._state.planner_parameters:
            raise InputError(f"{event.name} cannot be set: no {PLANNER} has reported it")
        if not math.isfinite(event.value):
            raise InputError(f"{event.name}: {event.value} is not finite")
        self._requested[event.name] = float(event.value)

    def survey(self, now: float) -> None:
        """Check whether the planner is running, and read its parameters if they are unknown."""
        if not self._client.services_are_ready():
            self._forget()
        elif not self._state.planner_parameters and self._reading is None:
            self._reading = (
                self._client.describe_parameters(list(PARAMETER_NAMES)),
                self._client.get_parameters([*PARAMETER_NAMES, *WORKSPACE_NAMES]),
                now + ANSWER_TIMEOUT,
            )

    def collect(self, now: float) -> None:
        """Collect answers, and send the requested values."""
        if self._reading is not None:
            described, read, deadline = self._reading
            if described.done() and read.done():
                self._reading = None
                self._store_parameters(described.result().descriptors, read.result().values)
            elif now > deadline:
                self._reading = None
        if self._setting is not None:
            future, values, deadline = self._setting
            if future.done():
                self._setting = None
                self._store_results(values, future.result().results)
            elif now > deadline:
                self._setting = None
                self._state.note = f"{PLANNER} does not answer"
        if self._requested and self._setting is None:
            values, self._requested = self._requested, {}
            request = [Parameter(name, value=value) for name, value in values.items()]
            self._setting = self._client.set_parameters(request), values, now + ANSWER_TIMEOUT

    def _store_parameters(self, descriptors: Any, values: Any) -> None:
        names = (*PARAMETER_NAMES, *WORKSPACE_NAMES)
        if len(values) != len(names) or len(descriptors) != len(PARAMETER_NAMES):
            return
        known = {
            name: value.double_value
            for name, value in zip(names, values, strict=True)
            if value.type == ParameterType.PARAMETER_DOUBLE
        }
        self._state.planner_parameters = {
            name: TunableParameter(
                known[name], bounds.from_value, bounds.to_value, descriptor.description
            )
            for name, descriptor in zip(PARAMETER_NAMES, descriptors, strict=True)
            for bounds in descriptor.floating_point_range[:1]
            if name in known
        }
        self._workspace = {name: known[name] for name in WORKSPACE_NAMES if name in known}
        self._update_workspace()

    def _store_results(self, values: dict[str, float], results: Any) -> None:
        for (name, value), result in zip(values.items(), results, strict=False):
            if result.successful:
                self._change(name, value)
            else:
                self._state.note = f"{name} REFUSED ({result.reason})"

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node != self._planner or not self._state.planner_parameters:
            return
        changed: list[ParameterMsg] = [*event.new_parameters, *event.changed_parameters]
        for parameter in changed:
            if parameter.value.type == ParameterType.PARAMETER_DOUBLE:
                self._change(parameter.name, parameter.value.double_value)

    def _change(self, name: str, value: float) -> None:
        parameters = self._state.planner_parameters
        if name in parameters:
            parameters[name] = replace(parameters[name], value=value)
        elif name in self._workspace:
            self._workspace[name] = value
            self._update_workspace()

    def _update_workspace(self) -> None:
        complete = len(self._workspace) == len(WORKSPACE_NAMES)
        x_min, y_min, x_max, y_max = (self._workspace.get(name, 0.0) for name in WORKSPACE_NAMES)
        self._state.workspace = (x_min, y_min, x_max, y_max) if complete else None

    def _forget(self) -> None:
        self._state.planner_parameters, self._workspace = {}, {}
        self._state.workspace = None
        self._reading, self._setting = None, None
        self._requested.clear()
