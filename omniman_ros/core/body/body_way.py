"""All nine axes along a path of the tool, with derivatives by the path's parameter."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.posture import Postures
from omniman_ros.core.body.tool_curve import ToolCurve

Array = NDArray[np.float64]

SPACE = 0.005
"""Longest way between samples [m of u]."""
FEWEST = 20
"""Spaces between samples."""
SHORTEST = 1e-6
"""Samples nearer to each other are one [m of u]."""
NUDGE = 1e-5
"""Way over which the Jacobian's change is measured [m of u]."""


class PlatformSpline:
    """A uniform cubic B-spline with poses as control points, mirrored in its ends.

    It evens out its control points a little, but begins and ends exactly at the first and last.

    Args:
        points: (n + 1, 3) at equally spaced parameters, n >= 1.
        end: Parameter of the last; that of the first is 0.
    """

    def __init__(self, points: Array, end: float) -> None:
        first, last = 2.0 * points[0] - points[1], 2.0 * points[-1] - points[-2]
        self._points = np.vstack([first, points, last])
        self._space = end / (len(points) - 1)

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Poses (m, 3) at u (m,), and two derivatives."""
        i = np.clip((u / self._space).astype(np.intp), 0, len(self._points) - 4)
        s = (u / self._space - i)[:, None]
        a, b, c, d = (self._points[i + k] for k in range(4))
        # From the differences, so that far from the origin nothing is lost.
        ab, bc, cd = b - a, c - b, d - c
        bend, jerk = bc - ab, cd - 2.0 * bc + ab
        slope = 0.5 * (ab + bc)
        place = b + bend / 6.0 + s * (slope + s * (0.5 * bend + s * jerk / 6.0))
        h = self._space
        return place, (slope + s * (bend + 0.5 * s * jerk)) / h, (bend + s * jerk) / (h * h)


class BodyWay:
    """Nine axes as functions of u; the tool is on its path exactly.

    Args:
        model: Kinematics.
        tool: The tool's path.
        postures: How the platform goes along.
        branch: Of the arm, :meth:`ArmModel.inverse`.
    """

    def __init__(self, model: BodyModel, tool: ToolCurve, postures: Postures, branch: int) -> None:
        self._model, self._branch = model, branch
        self.tool = tool
        self._nodes, self._arm = postures.at, postures.arm
        self._platform = PlatformSpline(postures.platform, tool.end)

    @property
    def end(self) -> float:
        """Largest u [m]."""
        return self.tool.end

    def samples(self) -> Array:
        """Values (n,) of u between which the second derivative is about linear."""
        even = np.linspace(0.0, self.end, 1 + max(FEWEST, math.ceil(self.end / SPACE)))
        u: Array = np.unique(np.concatenate([even, self.tool.knots]))
        u = u[np.concatenate([[True], np.diff(u) > SHORTEST])]
        u[-1] = self.end
        return u

    def axes(self, u: Array) -> Array:
        """All axes (m, 9) at u (m,)."""
        return self._axes(u, self._platform.motion(u)[0], self.tool.pose(u))

    def motion(self, u: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Axes (m, 9), two derivatives of them, and the tool's twist (m, 6) and its derivative.

        All are by u. The second derivative solves J q'' = a - J' q' for the arm's part.
        """
        pose, twist, change = self.tool.motion(u)
        place, rate, rise = self._platform.motion(u)
        q = self._axes(u, place, pose)
        jacobian = self._model.jacobian(q)
        arm, base = jacobian[:, :, 3:], jacobian[:, :, :3]
        first = np.hstack([rate, _solved(arm, twist - _times(base, rate))])
        turned = self._model.jacobian(q + NUDGE * first)
        turned -= self._model.jacobian(q - NUDGE * first)
        drift = _times(turned, first) / (2.0 * NUDGE)
        second = np.hstack([rise, _solved(arm, change - drift - _times(base, rise))])
        return q, first, second, twist, change

    def _axes(self, u: Array, place: Array, pose: Array) -> Array:
        near = np.column_stack([np.interp(u, self._nodes, joint) for joint in self._arm.T])
        return np.hstack([place, self._model.arm_angles(place, pose, self._branch, near)])


def _times(matrix: Array, vectors: Array) -> Array:
    result: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return result


def _solved(matrix: Array, vectors: Array) -> Array:
    found = np.linalg.solve(matrix, vectors[:, :, None])[:, :, 0]
    return np.asarray(found, dtype=float)
