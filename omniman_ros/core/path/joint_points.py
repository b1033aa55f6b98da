"""Points of some axes as a message gives them, and the motion through them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.path import given_times
from omniman_ros.core.path.axis_limits import AxisLimits
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.planner import LONGEST, PathPlanner
from omniman_ros.core.path.timed_curve import TimedCurve
from omniman_ros.core.path.trajectory import Trajectory

Array = NDArray[np.float64]

SHORTEST = 1e-6
"""Between two points [s]."""
SAME_SPEED = 0.05
"""How far the velocity of a first point with time 0 may be from the axes' own [rad/s]."""


@dataclass(frozen=True)
class JointPoints:
    """Where some axes are to be, and when.

    Attributes:
        columns: (m,) which axes.
        times: (k,) from the start of the trajectory [s], 0 or later and increasing; None: as
            soon as the limits allow.
        positions: (k, m) [rad or m].
        velocities, accelerations: (k, m), or None where they are not given.

    Raises:
        InputError: Shapes that do not fit, values that are not finite or are huge, times that do
            not increase, accelerations without velocities, velocities without times.
    """

    columns: tuple[int, ...]
    times: Array | None
    positions: Array
    velocities: Array | None = None
    accelerations: Array | None = None

    def __post_init__(self) -> None:
        shape = (len(self.positions), len(self.columns))
        if min(shape) == 0 or len(set(self.columns)) != len(self.columns):
            raise InputError(f"{shape[0]} points of axes {self.columns}")
        for label, array, bound in (
            ("positions", self.positions, plausible.ANGLE),
            ("velocities", self.velocities, plausible.SPEED),
            ("accelerations", self.accelerations, plausible.ACCELERATION),
        ):
            if array is not None and array.shape != shape:
                raise InputError(f"{label} of shape {array.shape}, expected {shape}")
            if array is not None:
                plausible.demand(array, bound, label)
        if self.velocities is None and self.accelerations is not None:
            raise InputError("accelerations without velocities")
        if self.times is None:
            if self.velocities is not None and self.velocities.any():
                raise InputError("velocities without times")
            return
        plausible.demand(self.times, LONGEST, "times")
        if self.times.shape != shape[:1] or self.times[0] < 0.0:
            raise InputError(f"times {self.times[:3].tolist()} for {shape[0]} points")
        late = np.flatnonzero(~(np.diff(self.times) >= SHORTEST))
        if len(late):
            i = int(late[0])
            raise InputError(
                f"the times do not increase: point {i} at {self.times[i]:g} s, point {i + 1} at "
                f"{self.times[i + 1]:g} s (all zero: they are computed)"
            )


@dataclass(frozen=True)
class State:
    """Position, velocity and acceleration (d,) of all axes at an instant."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def rest(cls, position: Array) -> "State":
        """At rest at a place."""
        return cls(np.array(position, dtype=float), *np.zeros((2, len(position))))


class JointPlanner:
    """Makes motions of all axes from points of some; those that are not named keep their place.

    Args:
        limits: Of all axes.
        options: How trajectories are taken.
        dt: Tick of the time base [s].
    """

    def __init__(self, limits: AxisLimits, options: JointTrajectoryOptions, dt: float) -> None:
        self.limits, self.options, self._dt = limits, options, dt
        share = 1.0 - options.reserve
        groups = limits.groups(share, options.corner_tolerance)
        self._planner = PathPlanner(groups, dt, limits.cap(share))

    def timed(self, points: JointPoints, state: State) -> TimedCurve:
        """The motion that keeps the points' times, from a state on.

        With positions only it is the motion of least jerk; with velocities the third derivative
        is continuous; accelerations are kept, too. At a first point with time 0 the axes are
        already; the last is a rest.

        Args:
            points: With times.
            state: At time 0.

        Raises:
            InputError: It begins somewhere else, ends in motion or cannot keep the limits.
        """
        points = self._started(points, state)
        assert points.times is not None
        self._ends_at_rest(points)
        columns = list(points.columns)
        times = np.concatenate([[0.0], points.times])
        shape = (len(times), len(self.limits.names))
        x, v, a = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        # Axes that are not named come to rest at once, and stay there.
        span = times[1]
        x[:] = state.position + span * (0.5 * state.velocity + span / 12.0 * state.acceleration)
        x[0], v[0], a[0] = state.position, state.velocity, state.acceleration
        x[1:, columns] = points.positions
        first_v, first_a = state.velocity[columns], state.acceleration[columns]
        if points.velocities is None:
            v[:, columns], a[:, columns] = given_times.least_jerk(
                times, x[:, columns], first_v, first_a
            )
        else:
            v[1:, columns] = points.velocities
            v[-1] = 0.0
            if points.accelerations is None:
                a[:, columns] = given_times.accelerations(
                    times, x[:, columns], v[:, columns], first_a
                )
            else:
                a[1:, columns] = points.accelerations
                a[-1, columns] = 0.0  # that of the rest which follows
        curve = TimedCurve(times, x, v, a)
        self.limits.demand_kept(curve, self.options.jerk_scale)
        return curve

    def fastest(self, points: JointPoints, position: Array) -> TimedCurve:
        """The motion from rest through points without times, as soon as the limits allow.

        Raises:
            InputError: Nowhere to go, beyond a position's limit, or it would last too long.
        """
        places = np.tile(position, (len(points.positions), 1))
        places[:, list(points.columns)] = points.positions
        self.limits.demand_within(places)
        plan = self._planner.plan(np.vstack([position, places]))
        motion = Trajectory(0.0, self._dt, plan.ticks, self._planner.smoother)
        times: Array = self._dt * np.arange(len(motion.positions), dtype=float)
        return TimedCurve(times, motion.positions, motion.velocities, motion.accelerations)

    def _started(self, points: JointPoints, state: State) -> JointPoints:
        """The points after the state; a first one with time 0 must be there."""
        assert points.times is not None
        if points.times[0] > 0.0:
            return points
        columns = list(points.columns)
        off = np.abs(points.positions[0] - state.position[columns])
        k = int(off.argmax())
        if off[k] > self.options.start_tolerance:
            name, unit = self.limits.names[columns[k]], self.limits.units[columns[k]]
            raise InputError(
                f"{name}: it begins {off[k]:.3g} {unit} from where it is, at most "
                f"{self.options.start_tolerance:g} {unit} are allowed with a first time of 0"
            )
        if points.velocities is not None:
            change = np.abs(points.velocities[0] - state.velocity[columns])
            k = int(change.argmax())
            if change[k] > SAME_SPEED:
                name, unit = self.limits.names[columns[k]], self.limits.units[columns[k]]
                raise InputError(
                    f"{name}: it begins with {points.velocities[0][k]:.3g} {unit}/s, it has "
                    f"{state.velocity[columns[k]]:.3g} {unit}/s"
                )
        arrays = (points.positions, points.velocities, points.accelerations)
        later = (None if array is None else array[1:] for array in arrays)
        return JointPoints(points.columns, points.times[1:], *later)  # type: ignore[arg-type]

    def _ends_at_rest(self, points: JointPoints) -> None:
        if points.velocities is not None and (np.abs(points.velocities[-1]) > 1e-6).any():
            k = int(np.abs(points.velocities[-1]).argmax())
            i = points.columns[k]
            raise InputError(
                f"{self.limits.names[i]}: it ends with {points.velocities[-1][k]:.3g} "
                f"{self.limits.units[i]}/s, not at rest"
            )
