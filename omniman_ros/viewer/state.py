"""What the viewer knows of a robot: the last of everything, trails and windows of bounded size."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.viewer.crowd import Rows
from omniman_ros.viewer.lines import Line, Trail
from omniman_ros.viewer.window import Window

Array = NDArray[np.float64]
Pose = tuple[float, float, float]
"""x, y [m], heading [rad] in `odom`."""

FORGET = 3.0
"""Silence after which what a node complained of is no longer shown [s]."""
SILENCE = 1.0
"""Age at which something is no longer taken for the present [s]."""


@dataclass(frozen=True)
class Condition:
    """What a node says of itself.

    Attributes:
        level: 0 good, 1 warning, 2 error.
        text: In words.
        heard: When [s].
    """

    level: int
    text: str
    heard: float = 0.0


@dataclass(frozen=True)
class Tunable:
    """A parameter of the planner that the page can set.

    Attributes:
        value: As the node has it.
        low, high: What the node takes.
        text: What it means.
    """

    value: float
    low: float
    high: float
    text: str


class Picture:
    """All that is shown.

    Args:
        wheels: Number of wheels n.
        constraints: Number of coupling errors m.

    Attributes:
        odom, truth: Poses, None until heard.
        odom_trail, truth_trail: Where they have been.
        path, reference: The platform's path as sent, and what comes next of it.
        tool_path: Path of the tool (k, 3).
        plan, route: Of the planner: the planned motion, and the way that leads it.
        predicted: Outlines of where the planner expects obstacles.
        wheel_angles: (n,) measured [rad].
        arm: (6,) measured joint angles [rad], None until heard.
        windows: Curves of the plots by name: `speeds`, n measured and n commanded [rad/s];
            `coupling`, m [rad]; `voltages`, n [V]; `energy`, of all wheels since they were
            first heard [J]; `solving`, time [ms] and slack [mm]; `sending`, mean and longest
            interval between two setpoints of the arm [ms].
        goal, start: Poses, None until there is one.
        crowd: Obstacles of the page; `chosen` is the number of the one that is chosen, `holding`
            whether they stand.
        seen: Obstacles of others, where they are now.
        workspace: x_min, y_min, x_max, y_max of the planner [m], where it has been heard.
        tunables: The planner's parameters by name, in the order of the page.
        planner: What `mpc/status` says, by key.
        case: Name of the case that is loaded, empty for none.
        active_source: Who drives, empty if not heard.
        progress: Of the path, 0 to 1; it counts while it is fresh.
        stops: Node name to its stop state.
        complaints: Node name to what it warns of in its diagnostics.
        services: Names of the services that can be called, as `path_interpolator/pause`.
        note: What the last button did.
    """

    def __init__(self, wheels: int, constraints: int) -> None:
        self.odom: Pose | None = None
        self.truth: Pose | None = None
        self.odom_trail, self.truth_trail = Trail(), Trail()
        self.path, self.reference, self.tool_path = Line(), Line(), Line()
        self.plan, self.route, self.predicted = Line(), Line(), Line()
        self.wheel_angles = np.zeros(wheels)
        self.arm: Array | None = None
        self._counts = {
            "measured": wheels, "commanded": wheels, "coupling": constraints, "voltages": wheels,
            "energy": 1, "solving": 2, "sending": 2,
        }  # fmt: skip
        self._values = {name: np.full(count, np.nan) for name, count in self._counts.items()}
        self.windows = {
            "speeds": Window(2 * wheels),
            **{
                name: Window(self._counts[name])
                for name in ("coupling", "voltages", "energy", "solving", "sending")
            },
        }
        self.goal: Pose | None = None
        self.start: Pose | None = None
        self.crowd = Rows.none()
        self.chosen: int | None = None
        self.holding = False
        self.seen = Ellipses.none()
        self.workspace: tuple[float, float, float, float] | None = None
        self.tunables: dict[str, Tunable] = {}
        self.planner: dict[str, str] = {}
        self.case = ""
        self.active_source = ""
        self.progress = 0.0
        self.stops: dict[str, Condition] = {}
        self.complaints: dict[str, Condition] = {}
        self.services: frozenset[str] = frozenset()
        self.note = ""
        self._heard: dict[str, float] = {}

    def hear_odom(self, pose: Pose, now: float) -> None:
        """Take in a pose of odometry."""
        self.odom = pose
        self.odom_trail.add(*pose[:2])
        self._heard["odom"] = now

    def hear_truth(self, pose: Pose, now: float) -> None:
        """Take in a pose of the simulation."""
        self.truth = pose
        self.truth_trail.add(*pose[:2])
        self._heard["truth"] = now

    def hear_wheels(self, angles: Array | None, speeds: Array | None, now: float) -> None:
        """Take in measured angles (n,) [rad] and speeds (n,) [rad/s]."""
        if angles is not None:
            self.wheel_angles = angles
        if speeds is not None:
            self.hear("measured", speeds, now)

    def hear_commands(self, speeds: Array | None, now: float) -> None:
        """Take in commanded speeds (n,) [rad/s], None in torque and voltage mode."""
        unknown = np.full_like(self._values["commanded"], np.nan)
        self.hear("commanded", unknown if speeds is None else speeds, now)

    def hear_arm(self, angles: Array, now: float) -> None:
        """Take in measured joint angles (6,) [rad]."""
        self.arm = angles
        self._heard["arm"] = now

    def hear(self, name: str, values: Array, now: float) -> None:
        """Take in values of a plot: measured, commanded, coupling, voltages, energy, ...

        What is too long is cut, what is too short leaves the rest unknown.
        """
        kept = self._values[name] = np.full(self._counts[name], np.nan)
        shown = min(len(values), len(kept))
        kept[:shown] = values[:shown]
        self._heard[name] = now

    def hear_reference(self, points: Array, now: float) -> None:
        """Take in what comes next of a path, points (k, 2) [m]."""
        self.reference.set(points)
        self._heard["reference"] = now

    def hear_plan(self, points: Array, now: float) -> None:
        """Take in the planned motion, points (k, 2) [m]."""
        self.plan.set(points)
        self._heard["plan"] = now

    def hear_predicted(self, outlines: Array, now: float) -> None:
        """Take in where the planner expects obstacles, outlines (k, 2) [m]."""
        self.predicted.set(outlines)
        self._heard["predicted"] = now

    def hear_planner(self, said: dict[str, str], now: float) -> None:
        """Take in what the planner says of itself."""
        self.planner = said
        self._heard["planner"] = now

    def hear_progress(self, progress: float, now: float) -> None:
        """Take in how much of the path is driven, 0 to 1."""
        self.progress = progress
        self._heard["progress"] = now

    def hear_complaint(self, name: str, level: int, text: str, now: float) -> None:
        """Take in a node's diagnostics; good news clears what it complained of."""
        if level == 0:
            self.complaints.pop(name, None)
        else:
            self.complaints[name] = Condition(level, text, now)

    def sample(self, now: float) -> None:
        """Add what is known now to the plots, and forget what is not repeated."""
        known = {
            name: values if self.is_fresh(name, now) else np.full_like(values, np.nan)
            for name, values in self._values.items()
        }
        known["speeds"] = np.concatenate([known["measured"], known["commanded"]])
        for name, window in self.windows.items():
            window.sample(now, known[name])
        for line, name in (
            (self.reference, "reference"), (self.plan, "plan"), (self.predicted, "predicted"),
        ):  # fmt: skip
            if len(line.points) and not self.is_fresh(name, now):
                line.set(line.points[:0])
        self.complaints = {
            name: condition
            for name, condition in self.complaints.items()
            if now - condition.heard < FORGET
        }

    def start_over(self) -> None:
        """Time went back: nothing was heard yet in the new time, and the plots are empty."""
        self._heard.clear()
        self.complaints.clear()
        for window in self.windows.values():
            window.clear()

    def is_fresh(self, what: str, now: float) -> bool:
        """Whether it was heard in the last second: odom, truth, arm, progress, ..."""
        return now - self._heard.get(what, -np.inf) < SILENCE

    def keep_stops(self, there: Iterable[str]) -> None:
        """Mark the nodes that are no longer there."""
        there = set(there)
        for name, condition in self.stops.items():
            if name not in there and condition.text != "gone":
                self.stops[name] = Condition(2, "gone")
