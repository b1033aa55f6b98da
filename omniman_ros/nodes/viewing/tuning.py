"""The planner's parameters that the page sets, through the planner's own services."""

import math
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_parameter_events

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.viewer.events import Tuned
from omniman_ros.viewer.state import Picture, Tunable

PLANNER = "mpc_planner"
TUNED = (
    "weights.position", "weights.heading", "weights.velocity", "weights.running",
    "weights.energy", "safety.clearance", "safety.least_clearance", "safety.berth",
)  # fmt: skip
"""In the order of the page."""
WORKSPACE = ("workspace.x_min", "workspace.y_min", "workspace.x_max", "workspace.y_max")
PATIENCE = 4.0
"""How long an answer is waited for [s]."""


class Tuning:
    """Reads and sets the parameters; answers are looked for once a period, nothing waits.

    Args:
        node: Who asks.
        picture: Shows them, and in its note what was refused.
    """

    def __init__(self, node: OmnimanNode, picture: Picture) -> None:
        self._picture = picture
        self._planner = f"{node.get_namespace().rstrip('/')}/{PLANNER}"
        self._client = AsyncParameterClient(node, PLANNER)
        self._asking: tuple[Any, Any, float] | None = None
        self._setting: tuple[Any, dict[str, float], float] | None = None
        self._wanted: dict[str, float] = {}
        self._walls: dict[str, float] = {}
        node.create_subscription(
            ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events
        )

    def set(self, event: Tuned, now: float) -> None:
        """Set a parameter; of several values in a row the last is sure to be set.

        Raises:
            InputError: It is not one of those of the page, or the value is not finite.
        """
        if event.name not in self._picture.tunables:
            raise InputError(f"{event.name} cannot be set: no {PLANNER} has told of it")
        if not math.isfinite(event.value):
            raise InputError(f"{event.name}: {event.value} is not finite")
        self._wanted[event.name] = float(event.value)

    def survey(self, now: float) -> None:
        """Look whether the planner is there; ask it what is not known."""
        if not self._client.services_are_ready():
            self._forget()
        elif not self._picture.tunables and self._asking is None:
            self._asking = (
                self._client.describe_parameters(list(TUNED)),
                self._client.get_parameters([*TUNED, *WORKSPACE]),
                now + PATIENCE,
            )

    def collect(self, now: float) -> None:
        """Take in answers, and send what is wanted."""
        if self._asking is not None:
            described, got, until = self._asking
            if described.done() and got.done():
                self._asking = None
                self._learn(described.result().descriptors, got.result().values)
            elif now > until:
                self._asking = None
        if self._setting is not None:
            future, values, until = self._setting
            if future.done():
                self._setting = None
                self._take_answer(values, future.result().results)
            elif now > until:
                self._setting = None
                self._picture.note = f"{PLANNER} does not answer"
        if self._wanted and self._setting is None:
            values, self._wanted = self._wanted, {}
            request = [Parameter(name, value=value) for name, value in values.items()]
            self._setting = self._client.set_parameters(request), values, now + PATIENCE

    def _learn(self, descriptors: Any, values: Any) -> None:
        """Take in what the parameters are and may be."""
        names = (*TUNED, *WORKSPACE)
        if len(values) != len(names) or len(descriptors) != len(TUNED):
            return
        known = {
            name: value.double_value
            for name, value in zip(names, values, strict=True)
            if value.type == ParameterType.PARAMETER_DOUBLE
        }
        self._picture.tunables = {
            name: Tunable(known[name], bounds.from_value, bounds.to_value, descriptor.description)
            for name, descriptor in zip(TUNED, descriptors, strict=True)
            for bounds in descriptor.floating_point_range[:1]
            if name in known
        }
        self._walls = {name: known[name] for name in WORKSPACE if name in known}
        self._show_walls()

    def _take_answer(self, values: dict[str, float], results: Any) -> None:
        for (name, value), result in zip(values.items(), results, strict=False):
            if result.successful:
                self._change(name, value)
            else:
                self._picture.note = f"{name} REFUSED ({result.reason})"

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node != self._planner or not self._picture.tunables:
            return
        changed: list[ParameterMsg] = [*event.new_parameters, *event.changed_parameters]
        for parameter in changed:
            if parameter.value.type == ParameterType.PARAMETER_DOUBLE:
                self._change(parameter.name, parameter.value.double_value)

    def _change(self, name: str, value: float) -> None:
        tunables = self._picture.tunables
        if name in tunables:
            tunables[name] = replace(tunables[name], value=value)
        elif name in self._walls:
            self._walls[name] = value
            self._show_walls()

    def _show_walls(self) -> None:
        complete = len(self._walls) == len(WORKSPACE)
        x_min, y_min, x_max, y_max = (self._walls.get(name, 0.0) for name in WORKSPACE)
        self._picture.workspace = (x_min, y_min, x_max, y_max) if complete else None

    def _forget(self) -> None:
        self._picture.tunables, self._walls = {}, {}
        self._picture.workspace = None
        self._asking, self._setting = None, None
        self._wanted.clear()
