"""Positions of all nine axes along a path of the tool, with derivatives by its parameter."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.redundancy_resolver import RobotConfigurations
from omniman_ros.motion.whole_body.tool_curve import ToolCurve

SAMPLE_SPACING = 0.005  #: Largest distance between samples [m of u]
MIN_INTERVALS = 20  #: Smallest number of intervals between samples
SAME_SAMPLE = 1e-6  #: Distance up to which two samples count as one [m of u]
DIFFERENCE_STEP = 1e-5  #: Step of the numerical derivative of the Jacobian [m of u]


class PlatformSpline:
    """Uniform cubic B-spline with poses of the platform as control points, mirrored at its ends.

    It smooths its control points slightly, but starts and ends exactly at the first and last.

    Args:
        points: (n + 1, 3) poses at equally spaced parameters, n >= 1.
        end: Parameter of the last pose; that of the first is 0.
    """

    def __init__(self, points: Array, end: float) -> None:
        first, last = 2.0 * points[0] - points[1], 2.0 * points[-1] - points[-2]
        self._points = np.vstack([first, points, last])
        self._space = end / (len(points) - 1)

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Return poses (m, 3) at u (m,), and two derivatives."""
        i = np.clip((u / self._space).astype(np.intp), 0, len(self._points) - 4)
        s = (u / self._space - i)[:, None]
        a, b, c, d = (self._points[i + k] for k in range(4))
        # Computed from differences, so that no precision is lost far from the origin.
        ab, bc, cd = b - a, c - b, d - c
        bend, jerk = bc - ab, cd - 2.0 * bc + ab
        slope = 0.5 * (ab + bc)
        pose = b + bend / 6.0 + s * (slope + s * (0.5 * bend + s * jerk / 6.0))
        h = self._space
        return pose, (slope + s * (bend + 0.5 * s * jerk)) / h, (bend + s * jerk) / (h * h)


class WholeBodyPath:
    """Nine axes as functions of u, with the tool exactly on its path.

    Args:
        branch: Branch of the arm's inverse kinematics, :meth:`ArmModel.inverse`.
    """

    def __init__(
        self,
        model: WholeBodyModel,
        tool: ToolCurve,
        configurations: RobotConfigurations,
        branch: int,
    ) -> None:
        self._model, self._branch = model, branch
        self.tool = tool
        self._nodes, self._arm = configurations.at, configurations.arm
        self._platform = PlatformSpline(configurations.platform, tool.end)

    @property
    def end(self) -> float:
        """Parameter u at the end of the path [m]."""
        return self.tool.end

    def samples(self) -> Array:
        """Return values (n,) of u between which the second derivative is approximately linear."""
        even = np.linspace(
            0.0, self.end, 1 + max(MIN_INTERVALS, math.ceil(self.end / SAMPLE_SPACING))
        )
        u: Array = np.unique(np.concatenate([even, self.tool.knots]))
        u = u[np.concatenate([[True], np.diff(u) > SAME_SAMPLE])]
        u[-1] = self.end
        return u

    def axes(self, u: Array) -> Array:
        """Return all axes (m, 9) at u (m,)."""
        return self._axes(u, self._platform.motion(u)[0], self.tool.pose(u))

    def motion(self, u: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return axes (m, 9), two derivatives, and the tool's twist (m, 6) and its derivative.

        All derivatives are by u. The second one solves J q'' = a - J' q' for the arm's part.
        """
        pose, twist, change = self.tool.motion(u)
        platform, rate, bend = self._platform.motion(u)
        q = self._axes(u, platform, pose)
        jacobian = self._model.jacobian(q)
        arm, base = jacobian[:, :, 3:], jacobian[:, :, :3]
        first = np.hstack([rate, _solved(arm, twist - _times(base, rate))])
        difference = self._model.jacobian(q + DIFFERENCE_STEP * first)
        difference -= self._model.jacobian(q - DIFFERENCE_STEP * first)
        drift = _times(difference, first) / (2.0 * DIFFERENCE_STEP)  # J' q'
        second = np.hstack([bend, _solved(arm, change - drift - _times(base, bend))])
        return q, first, second, twist, change

    def _axes(self, u: Array, platform: Array, pose: Array) -> Array:
        """Return all axes (m, 9) for poses of the platform (m, 3) and of the tool (m, 4, 4)."""
        near = np.column_stack([np.interp(u, self._nodes, joint) for joint in self._arm.T])
        return np.hstack([platform, self._model.arm_angles(platform, pose, self._branch, near)])


def _times(matrix: Array, vectors: Array) -> Array:
    result: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return result


def _solved(matrix: Array, vectors: Array) -> Array:
    solution = np.linalg.solve(matrix, vectors[:, :, None])[:, :, 0]
    return np.asarray(solution, dtype=float)
