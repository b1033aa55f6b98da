"""From a Cartesian path of the tool to the motion of all nine axes."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.body.body_way import BodyWay
from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import AXES, BodyModel, planar
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.body.posture import PostureResolver
from omniman_ros.core.body.tool_curve import ToolCurve
from omniman_ros.core.body.tool_timing import Clock, ToolTimer
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.timed_curve import TimedCurve

Array = NDArray[np.float64]

RIGID = 1e-6
"""How far R R^T may be from 1."""


@dataclass(frozen=True)
class ToolPlan:
    """A motion of the whole body along a path of the tool.

    Attributes:
        curve: All axes (n, 9) at ticks, from rest at the start to rest.
        branch: Of the arm, :meth:`ArmModel.inverse`.
        length: Of the tool's way [m].
        path: The tool's path, seen from where the platform starts.
        clock: When it is where on the path.
        frame: (4, 4) where the platform starts, in odom.
    """

    curve: TimedCurve
    branch: int
    length: float
    path: ToolCurve = field(repr=False)
    clock: Clock = field(repr=False)
    frame: Array = field(repr=False)

    def tool(self, times: Array) -> Array:
        """Poses (m, 4, 4) of `tool0` in odom at times (m,) [s] of the curve, held at the ends."""
        result: Array = self.frame @ self.path.pose(self.clock.at(times))
        return result


class ToolPlanner:
    """Plans with the tool on its path exactly, and the platform where the arm likes it.

    All is planned as seen from where the platform starts: a path that is turned or moved together
    with the robot gives the same motion.

    Args:
        model: Kinematics.
        limits: Of the nine axes.
        options: Tolerances, speeds of the tool, margins.
    """

    def __init__(self, model: BodyModel, limits: BodyLimits, options: ToolPathOptions) -> None:
        self._model, self._limits, self._options = model, limits, options
        self._resolver = PostureResolver(model, limits, options)
        self._timer = ToolTimer(limits, options)

    def plan(self, poses: Array, start: Array) -> ToolPlan:
        """Plan from rest to rest.

        Args:
            poses: (k, 4, 4) of `tool0` in odom, k >= 1; the tool goes straight to the first.
            start: (9,) all axes, at rest.

        Raises:
            InputError: Bad input, a path too far away, out of reach or near a singularity, or
                nothing to do; the message names the place.
        """
        self._demand_good(poses, start)
        frame = planar(start[:3])
        now = self._model.forward(start)
        self._demand_near(poses[0], now)
        inverse = np.linalg.inv(frame)
        path = ToolCurve(inverse @ np.concatenate([now[None], poses]), self._options, frame)
        local = np.concatenate([np.zeros(3), start[3:]])
        self._resolver.signs(local[3:])  # on a singularity there is no branch
        branch = self._model.arm.branch_of(local[3:])
        way = BodyWay(self._model, path, self._resolver.resolve(path, local), branch)
        samples = way.samples()
        self._resolver.demand(path, samples, way.axes(samples)[:, 3:], local[3:])
        clock, curve = self._timer.timed(way)
        placed = _placed(curve, frame, start)
        self._limits.demand_kept(placed, 1.0)
        return ToolPlan(placed, branch, path.length(), path, clock, frame)

    def _demand_good(self, poses: Array, start: Array) -> None:
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
            raise InputError(f"poses of shape {poses.shape}, expected (k, 4, 4), k >= 1")
        if len(poses) > self._options.max_poses:
            raise InputError(f"{len(poses)} poses, at most {self._options.max_poses}")
        if start.shape != (AXES,):
            raise InputError(f"start of shape {start.shape}, expected ({AXES},)")
        plausible.demand(start, plausible.ANGLE, "start")
        for k in np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))[:1]:
            raise InputError(f"pose {k} of the path is not finite")
        plausible.demand(poses[:, :3, 3], plausible.LENGTH, "positions of the path")
        turn = poses[:, :3, :3]
        off = np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max(axis=(1, 2))
        bad = ~(off <= RIGID) | ~(np.linalg.det(turn) > 0.0)
        for k in np.flatnonzero(bad)[:1]:
            raise InputError(f"pose {k} of the path has no rotation matrix")
        self._limits.demand_within(start[None])

    def _demand_near(self, first: Array, now: Array) -> None:
        away = float(np.linalg.norm(first[:3, 3] - now[:3, 3]))
        if away > self._options.start_distance:
            x, y, z = now[:3, 3].tolist()
            raise InputError(
                f"the path begins {away:.3f} m from the tool at ({x:.3f}, {y:.3f}, {z:.3f}) m, at "
                f"most {self._options.start_distance:g} m"
            )


def _placed(curve: TimedCurve, frame: Array, start: Array) -> TimedCurve:
    """A motion seen from the start's platform, in odom."""
    turn = frame[:2, :2].T
    positions, velocities, accelerations = (
        np.hstack([rows[:, :2] @ turn, rows[:, 2:]])
        for rows in (curve.positions, curve.velocities, curve.accelerations)
    )
    positions[:, :3] += start[:3]
    positions[0] = start
    for rates in (velocities, accelerations):
        rates[[0, -1]] = 0.0
    return TimedCurve(curve.times, positions, velocities, accelerations)
