"""Data of one robot that the viewer shows: the latest values, trails and plots."""

from collections.abc import Iterable, Set
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.viewer.lines import Line, Trail
from omniman_ros.viewer.perceived import FRESHNESS_TIMEOUT, Perceived
from omniman_ros.viewer.placed_obstacles import ObstacleArrays
from omniman_ros.viewer.signal_window import SignalWindow
from omniman_ros.viewer.tool_goal import ToolGoal, ToolPose

Pose = tuple[float, float, float]  #: x, y [m], heading [rad] in `odom`

DIAGNOSTICS_TIMEOUT = 3.0  #: Age at which a warning or error that is not repeated goes [s]
PATH_NODES = ("path_interpolator", "whole_body_planner")  #: Nodes that drive along given paths
PAUSABLE_NODES = (*PATH_NODES, "mpc_planner")  #: Nodes that can be paused, resumed and cancelled
#: Values of `state` in `mpc/status` while the planner has a goal to drive to
_DRIVING_STATES = (PlannerState.DRIVING.value, PlannerState.BLOCKED.value)
_STATES_OF_ACTION = {
    "pause": {*_DRIVING_STATES, PathState.FOLLOWING.value, PathState.SLOWING.value},
    "resume": {PlannerState.PAUSED.value, PathState.PAUSING.value, PathState.PAUSED.value},
    "cancel": {state.value for state in (*PlannerState, *PathState)}
    - {PlannerState.IDLE.value, PlannerState.ARRIVED.value, PathState.IDLE.value},
}  #: States of planner and path interpolator to which each action applies


@dataclass(frozen=True)
class Condition:
    """State that a node reports about itself."""

    level: int  #: 0 ok, 1 warning, 2 error
    text: str  #: The state in words
    received_at: float = 0.0  #: Time at which it was received [s]


@dataclass(frozen=True)
class TunableParameter:
    """A parameter of the planner that the page can set."""

    value: float  #: The node's present value
    low: float  #: Smallest value that the node accepts
    high: float  #: Largest value that the node accepts
    text: str  #: Description of the parameter


class ViewState:
    """Everything that the page displays.

    Args:
        wheels: Number of wheels n.
        constraints: Number of motion constraints m of the wheels; each has a coupling error.

    Attributes:
        odom, truth: Poses by odometry and by the simulation's ground truth; None until received.
        odom_trail, truth_trail: Past positions of both, at most as many as a trail holds.
        path, reference: The platform's path as sent, and the part of it to be driven next.
        tool_path: Path of the tool (k, 3) [m].
        plan, route: The planner's planned motion, and the route that guides it.
        predicted: Outlines of the obstacles as the planner predicts them.
        windows: Curves of the plots by name: `speeds`, n measured and n commanded wheel speeds
            [rad/s]; `coupling`, m coupling errors without resets [rad]; `voltages`, n motor
            voltages [V]; `energy`, energy of all wheels since it was first received [J];
            `solving`, the planner's solution time [ms] and slack [mm]; `sending`, mean and
            longest interval between two setpoints of the arm [ms].
        goal, start: Poses of the planner's goal and of the start; None until there is one.
        tool_reports: Number of reports of the nodes that take paths of the tool since the page has
            sent one; None once the outcome is known.
    """

    def __init__(self, wheels: int, constraints: int) -> None:
        self.odom: Pose | None = None
        self.truth: Pose | None = None
        self.odom_trail, self.truth_trail = Trail(), Trail()
        #: Largest absolute component of the twist of `odom` and of `truth` [m/s, rad/s]
        self.speeds: dict[str, float] = {}
        self.path, self.reference, self.tool_path = Line(), Line(), Line()
        self.plan, self.route, self.predicted = Line(), Line(), Line()
        self._repeated = {"reference": self.reference, "plan": self.plan}
        self._repeated |= {"route": self.route, "predicted": self.predicted}
        self.wheel_angles = np.zeros(wheels)  #: Measured wheel angles (n,) [rad]
        self.arm: Array | None = None  #: Measured joint angles (6,) [rad]; None until received
        self._counts = {
            "measured": wheels,
            "commanded": wheels,
            "coupling": constraints,
            "voltages": wheels,
            "energy": 1,
            "solving": 2,
            "sending": 2,
        }
        self._values = {name: np.full(count, np.nan) for name, count in self._counts.items()}
        self.windows = {
            "speeds": SignalWindow(2 * wheels),
            **{
                name: SignalWindow(self._counts[name])
                for name in ("coupling", "voltages", "energy", "solving", "sending")
            },
        }
        self.goal: Pose | None = None
        self.start: Pose | None = None
        self.obstacles = ObstacleArrays.empty()  #: Obstacles that were placed on the page
        self.selected_obstacle: int | None = None  #: Number of the obstacle that is edited
        self.obstacles_paused = False  #: Whether the page's obstacles stand until Go or Resume
        self.other_obstacles = Ellipses.none()  #: Obstacles that the page has not placed
        #: The planner's x_min, y_min, x_max, y_max in `odom` [m]; None while unknown
        self.workspace: tuple[float, float, float, float] | None = None
        #: The planner's tunable parameters by name, in the order of the page
        self.planner_parameters: dict[str, TunableParameter] = {}
        self.planner: dict[str, str] = {}  #: Values of `mpc/status` by key
        self._outcomes: dict[str, Set[str]] = {}
        self._earlier_outcomes: dict[str, Set[str]] = {}
        #: States of the motions (platform, arm, whole body) of each of `PATH_NODES`
        self.path_states: dict[str, frozenset[str]] = {}
        self.case = ""  #: Name of the case (start, goal, obstacles) that is loaded, empty for none
        self.active_source = ""  #: Command source that drives the robot, empty until received
        self.progress = 0.0  #: Progress on the path, 0 to 1; valid while it is fresh
        self.stops: dict[str, Condition] = {}  #: Stop state of each node by its name
        #: Current warnings and errors from the diagnostics by name of the node
        self.diagnostics: dict[str, Condition] = {}
        self.pace: float | None = None  #: Speed of simulated over real time; None on real time
        self.awaited: tuple[str, ...] = ()  #: Names of the nodes for which simulated time stands
        #: Names of the available services, such as `path_interpolator/pause`
        self.services: frozenset[str] = frozenset()
        self.perceived = Perceived()  #: What scanners, tracker, monitor and physics world tell
        self.tool: ToolPose | None = None  #: Pose of the tool; None until received
        self.tool_goal = ToolGoal()  #: Handle and path of the tool that are set on the page
        self.tool_reports: int | None = None
        self.tour = ""  #: The present step of the tour, empty at its end
        self.unplaced: dict[str, str] = {}  #: Why a topic's last message is not shown, by topic
        self.note = ""  #: Outcome of the last action on the page
        self._received_at: dict[str, float] = {}

    def update_odom(self, pose: Pose, now: float) -> None:
        """Store a pose by odometry, received at `now` [s]."""
        self.odom = pose
        self.odom_trail.add(*pose[:2])
        self._received_at["odom"] = now

    def update_truth(self, pose: Pose, now: float) -> None:
        """Store the true pose of a simulated robot, received at `now` [s]."""
        self.truth = pose
        self.truth_trail.add(*pose[:2])
        self._received_at["truth"] = now

    def update_wheels(self, angles: Array | None, speeds: Array | None, now: float) -> None:
        """Store measured angles (n,) [rad] and speeds (n,) [rad/s]; None keeps the last ones."""
        if angles is not None:
            self.wheel_angles = angles
        if speeds is not None:
            self.update_signal("measured", speeds, now)

    def update_commands(self, speeds: Array | None, now: float) -> None:
        """Store commanded wheel speeds (n,) [rad/s]; None if torques or voltages are commanded."""
        unknown = np.full_like(self._values["commanded"], np.nan)
        self.update_signal("commanded", unknown if speeds is None else speeds, now)

    def update_arm(self, angles: Array, now: float) -> None:
        """Store measured joint angles (6,) [rad]."""
        self.arm = angles
        self._received_at["arm"] = now

    def update_tool(self, pose: ToolPose, now: float) -> None:
        """Store the pose of the tool, received at `now` [s]."""
        self.tool = pose
        self._received_at["tool"] = now

    def update_signal(self, name: str, values: Array, now: float) -> None:
        """Store the latest values of a signal for the plots.

        Args:
            name: `measured`, `commanded`, `coupling`, `voltages`, `energy`, `solving` or
                `sending`; units as in the attribute `windows`.
            values: Values of the signal; surplus ones are dropped, missing ones become NaN.
        """
        kept = self._values[name] = np.full(self._counts[name], np.nan)
        count = min(len(values), len(kept))
        kept[:count] = values[:count]
        self._received_at[name] = now

    def update_line(self, name: str, points: Array, now: float) -> None:
        """Store points (k, 2) in `odom` [m] of a line that is sent again and again.

        Args:
            name: `reference`, `plan`, `route` or `predicted`, the last with outlines.
        """
        self._repeated[name].set(points)
        self._received_at[name] = now

    def update_planner(self, values: dict[str, str], now: float) -> None:
        """Store the planner's status, the values of `mpc/status` by key."""
        self.planner = values
        self._received_at["planner"] = now

    def begin_run(self) -> None:
        """Forget how the motions of each node ended: a new run begins."""
        self._earlier_outcomes = dict(self._outcomes)
        self.diagnostics = {
            name: condition
            for name, condition in self.diagnostics.items()
            if condition.text not in self._outcomes[name]
        }

    def update_progress(self, progress: float, now: float) -> None:
        """Store the progress on the path, 0 to 1."""
        self.progress = progress
        self._received_at["progress"] = now

    def update_diagnostics(
        self, name: str, level: int, text: str, now: float, outcomes: Set[str] = frozenset()
    ) -> None:
        """Store a node's warning or error, and in which words it tells how its motions ended.

        Level 0 clears it, and so does the end of a motion of an earlier run.
        """
        earlier = self._earlier_outcomes.get(name, frozenset()) & outcomes
        self._outcomes[name], self._earlier_outcomes[name] = outcomes, earlier
        if level == 0 or text in earlier:
            self.diagnostics.pop(name, None)
        else:
            self.diagnostics[name] = Condition(level, text, now)

    def sample(self, now: float) -> None:
        """Add the values at `now` [s] to the plots, and discard values that are out of date."""
        known = {
            name: values if self.is_fresh(name, now) else np.full_like(values, np.nan)
            for name, values in self._values.items()
        }
        known["speeds"] = np.concatenate([known["measured"], known["commanded"]])
        for name, window in self.windows.items():
            window.sample(now, known[name])
        for name, line in self._repeated.items():
            if len(line.points) and not self.is_fresh(name, now):
                line.set(line.points[:0])
        self.perceived.sample(now)
        self.diagnostics = {
            name: condition
            for name, condition in self.diagnostics.items()
            if now - condition.received_at < DIAGNOSTICS_TIMEOUT
        }

    def clear_trails(self) -> None:
        """Discard the past positions."""
        self.odom_trail.clear()
        self.truth_trail.clear()

    def reset_time(self) -> None:
        """Clear plots and diagnostics, and mark all values as old, after the clock jumped back."""
        self._received_at.clear()
        self.diagnostics.clear()
        self.pace, self.awaited = None, ()
        for window in self.windows.values():
            window.clear()

    def is_fresh(self, name: str, now: float) -> bool:
        """Return whether a value was received less than `FRESHNESS_TIMEOUT` before `now` [s].

        Args:
            name: `odom`, `truth`, `arm`, `tool`, `planner`, `progress`, a line of
                :meth:`update_line` or a signal of :meth:`update_signal`.
        """
        return now - self._received_at.get(name, -np.inf) < FRESHNESS_TIMEOUT

    def planner_is_driving(self, now: float) -> bool:
        """Return whether the planner reports that it has a goal to drive to."""
        return self.is_fresh("planner", now) and self.planner.get("state") in _DRIVING_STATES

    def planner_is_paused(self, now: float) -> bool:
        """Return whether the planner reports that it is paused on the way to a goal."""
        is_paused = self.planner.get("state") == PlannerState.PAUSED.value
        return self.is_fresh("planner", now) and is_paused

    def reports_nothing_to(self, action: str, node: str) -> bool:
        """Return whether an action does not apply to the state that a node last reported.

        Args:
            action: `pause`, `resume` or `cancel`.
            node: One of `PAUSABLE_NODES`.
        """
        if node == "mpc_planner":
            state = self.planner.get("state")
            states = frozenset() if state is None else frozenset({state})
        else:
            states = self.path_states.get(node, frozenset())
        return bool(states) and not states & _STATES_OF_ACTION[action]

    def mark_gone(self, present: Iterable[str]) -> None:
        """Set the stop state of each node that is not among those present to the error "gone"."""
        present = set(present)
        for name, condition in self.stops.items():
            if name not in present and condition.text != "gone":
                self.stops[name] = Condition(2, "gone")
