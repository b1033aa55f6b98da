"""Planning of the motion of all nine axes along a Cartesian path of the tool."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.axes import AXES
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.redundancy_resolver import RedundancyResolver
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_timing import PathProgress, ToolTimer, WholeBodyPath

RIGIDITY_TOLERANCE = 1e-6  #: Largest deviation of an element of R R^T from the identity
#: Number of decimals of poses in the frame of the platform's start: a picometre
DECIMALS = 12


@dataclass(frozen=True)
class ToolPlan(Validated):
    """Motion of the whole body along a path of the tool."""

    curve: TimedCurve  #: All axes (n, 9) at ticks, from rest at the start to rest
    branch: int  #: Branch of the arm's inverse kinematics, :meth:`ArmModel.inverse`
    length: float  #: Path length of the tool [m]
    path: ToolCurve = field(repr=False)  #: Path of the tool in the frame of the platform's start
    progress: PathProgress = field(repr=False)  #: Path parameter as a function of time
    #: (4, 4) pose of the platform at the start, in odom
    frame: Annotated[Array, Shape(4, 4)] = field(repr=False)

    def tool(self, times: Array) -> Array:
        """Return poses (m, 4, 4) of `tool0` in odom at times (m,) of the curve [s]."""
        result: Array = self.frame @ self.path.pose(self.progress.at(times))
        return result


class ToolPlanner:
    """Plans motions with the tool exactly on its path and the platform placed to suit the arm.

    All motions are planned in the frame of the platform's start: a path that is rotated or moved
    together with the robot gives the same motion.

    Args:
        options: Tolerances, speeds of the tool, and margins to singularities.
    """

    def __init__(
        self, model: WholeBodyModel, limits: WholeBodyLimits, options: ToolPathOptions
    ) -> None:
        self._model, self._limits, self._options = model, limits, options
        self._resolver = RedundancyResolver(model, limits, options)
        self._timer = ToolTimer(limits, options)

    def plan(self, poses: Array, start: Array) -> ToolPlan:
        """Plan from rest to rest.

        Args:
            poses: (k, 4, 4) of `tool0` in odom, k >= 1; the tool moves straight to the first.
            start: (9,) positions of all axes at rest.

        Raises:
            InputError: The input is invalid, the path is too far away, out of reach or near a
                singularity, or there is nothing to do; the message names the position.
        """
        self.require_valid(poses, start)
        frame = planar_transform(start[:3])
        tool = self._model.forward(start)
        inverse = np.linalg.inv(frame)
        # Without the round-off of the rotation, which would decide where two choices are equal.
        seen = np.round(inverse @ np.concatenate([tool[None], poses]), DECIMALS)
        path = ToolCurve(seen, self._options, frame)
        local = np.concatenate([np.zeros(3), start[3:]])
        self._resolver.signs(local[3:])  # raises on a singularity, where there is no branch
        branch = self._model.arm.branch_of(local[3:])
        whole_body = WholeBodyPath(self._model, path, self._resolver.resolve(path, local), branch)
        samples = whole_body.samples()
        self._resolver.require_possible(path, samples, whole_body.axes(samples)[:, 3:], local[3:])
        progress, curve = self._timer.timed(whole_body)
        placed = _placed(curve, frame, start)
        self._limits.require_kept(placed, 1.0)
        return ToolPlan(placed, branch, path.length(), path, progress, frame)

    def require_valid(self, poses: Array, start: Array) -> None:
        """Require a path that can be one, near the tool, for a robot that starts at axes (9,).

        Raises:
            InputError: The input is invalid, or the path is too far away.
        """
        self._check_input(poses, start)
        self._check_distance(poses[0], self._model.forward(start))

    def _check_input(self, poses: Array, start: Array) -> None:
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
            raise InputError(f"poses have shape {poses.shape}, expected (k, 4, 4), k >= 1")
        if len(poses) > self._options.max_poses:
            raise InputError(
                f"the path has {len(poses)} poses, at most {self._options.max_poses} are accepted"
            )
        if start.shape != (AXES,):
            raise InputError(f"start has shape {start.shape}, expected ({AXES},)")
        plausible.demand(start, plausible.ANGLE, "start")
        for k in np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))[:1]:
            raise InputError(f"pose {k} of the path is not finite")
        plausible.demand(poses[:, :3, 3], plausible.LENGTH, "positions of the path")
        rotation = poses[:, :3, :3]
        deviation = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
        invalid = ~(deviation <= RIGIDITY_TOLERANCE) | ~(np.linalg.det(rotation) > 0.0)
        for k in np.flatnonzero(invalid)[:1]:
            raise InputError(f"pose {k} of the path has no rotation matrix")
        self._limits.require_within(start[None])

    def _check_distance(self, first: Array, tool: Array) -> None:
        distance = float(np.linalg.norm(first[:3, 3] - tool[:3, 3]))
        if distance > self._options.start_distance:
            x, y, z = tool[:3, 3].tolist()
            raise InputError(
                f"the path starts {distance:.3f} m from the tool at ({x:.3f}, {y:.3f}, {z:.3f}) "
                f"m, at most {self._options.start_distance:g} m are allowed"
            )


def _placed(curve: TimedCurve, frame: Array, start: Array) -> TimedCurve:
    rotation = frame[:2, :2].T
    positions, velocities, accelerations = (
        np.hstack([rows[:, :2] @ rotation, rows[:, 2:]])
        for rows in (curve.positions, curve.velocities, curve.accelerations)
    )
    positions[:, :3] += start[:3]
    positions[0] = start
    for rates in (velocities, accelerations):
        rates[[0, -1]] = 0.0
    return TimedCurve(curve.times, positions, velocities, accelerations)
