"""Trajectory points of some axes, as in a message, and the planning of motions through them."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, round_off, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path import spline_derivatives
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.planner import MAX_DURATION, PathPlanner
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.path.trajectory import Trajectory

#: Largest difference between the velocity of a first point with time 0 and the present one
#: [rad/s].
MAX_START_SPEED_ERROR = 0.05


@dataclass(frozen=True)
class JointPoints(Validated):
    """Points of a trajectory of some axes.

    Attributes:
        velocities, accelerations: (k, m), or None if they are not given.

    Raises:
        InputError: Shapes do not match, values are not finite or implausibly large, times do not
            increase, or there are accelerations without velocities or velocities without times.
    """

    columns: tuple[int, ...]  #: (m,) indices of the axes
    #: (k,) from the start of the trajectory [s], 0 or later and increasing; None if the points are
    #: to be reached as soon as the limits allow. Of points that repeat each other but for
    #: round-off, the last counts.
    times: Annotated[Array | None, Shape("k")]
    positions: Annotated[Array, Shape("k", "m")]  #: (k, m) [rad or m]
    velocities: Annotated[Array | None, Shape("k", "m")] = None
    accelerations: Annotated[Array | None, Shape("k", "m")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = (len(self.positions), len(self.columns))
        if min(shape) == 0 or len(set(self.columns)) != len(self.columns):
            raise InputError(
                f"there are {shape[0]} points of axes {self.columns}: at least one point of at "
                "least one axis is needed, and no axis may be repeated"
            )
        for label, array, bound in (
            ("positions", self.positions, plausible.ANGLE),
            ("velocities", self.velocities, plausible.SPEED),
            ("accelerations", self.accelerations, plausible.ACCELERATION),
        ):
            if array is not None:
                plausible.demand(array, bound, label)
        if self.velocities is None and self.accelerations is not None:
            raise InputError("accelerations without velocities are not accepted")
        if self.times is None:
            if self.velocities is not None and not round_off.is_rest(self.velocities):
                raise InputError("velocities without times are not accepted")
            return
        plausible.demand(self.times, MAX_DURATION, "times")
        if self.times[0] < -round_off.SAME_TIME:
            raise InputError(f"times {self.times[:3].tolist()} must be at or after 0 s")
        self._keep(*round_off.distinct(self.times, self.positions))

    def _keep(self, times: Array, rows: NDArray[np.intp]) -> None:
        """Keep distinct times and the rows that go with them."""
        kept = {"times": times, "positions": self.positions[rows]}
        for label in ("velocities", "accelerations"):
            if getattr(self, label) is not None:
                kept[label] = getattr(self, label)[rows]
        for label, values in kept.items():
            values.setflags(write=False)
            object.__setattr__(self, label, values)

    def unwrapped(self, column: int, angle: float) -> "JointPoints":
        """Shift an axis that turns without end by whole revolutions to the nearest turns.

        Args:
            column: Index of the axis; points that do not name it are returned as they are.
            angle: Present position of the axis, to which the first point is nearest [rad].
        """
        if column not in self.columns:
            return self
        i = self.columns.index(column)
        positions = self.positions.copy()
        positions[:, i] = se2.nearest_turns(positions[:, i], angle)
        return replace(self, positions=positions)


@dataclass(frozen=True)
class KinematicState(Validated):
    """Position, velocity and acceleration (d,) of all axes at an instant."""

    position: Annotated[Array, Shape("d")]
    velocity: Annotated[Array, Shape("d")]
    acceleration: Annotated[Array, Shape("d")]

    @classmethod
    def rest(cls, position: Array) -> "KinematicState":
        """Create a state of rest at a position (d,)."""
        return cls(np.array(position, dtype=float), *np.zeros((2, len(position))))


class JointPlanner:
    """Plans motions of all axes through points of some; the other axes keep their positions."""

    def __init__(self, limits: AxisLimits, options: JointTrajectoryOptions) -> None:
        self.limits, self.options = limits, options
        scale = 1.0 - options.reserve
        groups = limits.groups(scale, options.corner_tolerance)
        self._planner = PathPlanner(groups, TICK, limits.speed_cap(scale))

    def timed(self, points: JointPoints, state: KinematicState) -> TimedCurve:
        """Plan the motion that keeps the times of the points, from a state on.

        From positions only, the motion minimises the jerk; with velocities, its third derivative
        is continuous; given accelerations are kept, too. A first point with time 0 must be the
        present state. The motion ends at rest.

        Raises:
            InputError: The motion starts somewhere else, ends in motion or violates the limits.
        """
        points = self._started(points, state)
        assert points.times is not None
        self._ends_at_rest(points)
        columns = list(points.columns)
        times = np.concatenate([[0.0], points.times])
        shape = (len(times), len(self.limits.names))
        x, v, a = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        # The other axes come to rest during the first piece, and stay there.
        span = times[1]
        x[:] = state.position + span * (0.5 * state.velocity + span / 12.0 * state.acceleration)
        x[0], v[0], a[0] = state.position, state.velocity, state.acceleration
        x[1:, columns] = points.positions
        first_v, first_a = state.velocity[columns], state.acceleration[columns]
        if points.velocities is None:
            v[:, columns], a[:, columns] = spline_derivatives.minimum_jerk(
                times, x[:, columns], first_v, first_a
            )
        else:
            v[1:, columns] = points.velocities
            v[-1] = 0.0
            if points.accelerations is None:
                a[:, columns] = spline_derivatives.accelerations(
                    times, x[:, columns], v[:, columns], first_a
                )
            else:
                a[1:, columns] = points.accelerations
                a[-1, columns] = 0.0  # the acceleration of the following rest
        curve = TimedCurve(times, x, v, a)
        self.limits.require_kept(curve, self.options.jerk_scale)
        return curve

    def through(self, positions: Array, start: Array) -> TimedCurve:
        """Plan the fastest motion of all axes on one path, from rest at a start (d,) to rest.

        Between positions (k, d), all axes are in step: at any time, each has covered the same
        fraction of its way. Corners are cut by `joint_trajectory.corner_tolerance`; at 0, the
        motion stops there.

        Raises:
            InputError: As for :meth:`fastest`.
        """
        return self.fastest(JointPoints(tuple(range(positions.shape[1])), None, positions), start)

    def fastest(self, points: JointPoints, position: Array) -> TimedCurve:
        """Plan the fastest motion within the limits from rest through points without times.

        Args:
            position: (d,) position at which all axes are at rest.

        Raises:
            InputError: There is nothing to do, a position is beyond its limit, or the motion
                would take too long.
        """
        places = np.tile(position, (len(points.positions), 1))
        places[:, list(points.columns)] = points.positions
        self.limits.require_within(places)
        plan = self._planner.plan(np.vstack([position, places]))
        motion = Trajectory(0.0, TICK, plan.ticks, self._planner.smoother)
        times: Array = TICK * np.arange(len(motion.positions), dtype=float)
        return TimedCurve(times, motion.positions, motion.velocities, motion.accelerations)

    def _started(self, points: JointPoints, state: KinematicState) -> JointPoints:
        assert points.times is not None
        if points.times[0] > round_off.SAME_TIME:
            return points
        columns = list(points.columns)
        distance = np.abs(points.positions[0] - state.position[columns])
        k = int(distance.argmax())
        if distance[k] > self.options.start_tolerance:
            name, unit = self.limits.names[columns[k]], self.limits.units[columns[k]]
            raise InputError(
                f"{name}: it starts {distance[k]:.3g} {unit} from its present position, at most "
                f"{self.options.start_tolerance:g} {unit} are allowed with a first time of 0"
            )
        if points.velocities is not None:
            change = np.abs(points.velocities[0] - state.velocity[columns])
            k = int(change.argmax())
            if change[k] > MAX_START_SPEED_ERROR:
                name, unit = self.limits.names[columns[k]], self.limits.units[columns[k]]
                raise InputError(
                    f"{name}: it starts with {points.velocities[0][k]:.3g} {unit}/s, its present "
                    f"velocity is {state.velocity[columns[k]]:.3g} {unit}/s"
                )
        arrays = (points.positions, points.velocities, points.accelerations)
        later = (None if array is None else array[1:] for array in arrays)
        return JointPoints(points.columns, points.times[1:], *later)  # type: ignore[arg-type]

    def _ends_at_rest(self, points: JointPoints) -> None:
        if points.velocities is not None and not round_off.is_rest(points.velocities[-1]):
            k = int(np.abs(points.velocities[-1]).argmax())
            i = points.columns[k]
            raise InputError(
                f"{self.limits.names[i]}: it ends with {points.velocities[-1][k]:.3g} "
                f"{self.limits.units[i]}/s, not at rest (up to {round_off.REST_SPEED:g})"
            )
