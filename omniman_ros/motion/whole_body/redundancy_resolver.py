"""Redundancy resolution of nine axes: the platform's motion while the tool follows a path.

The unknowns are the platform's poses at nodes along the path. The joint angles follow from them
and from the tool in closed form, dq/dp = -J_arm^-1 J_platform. Over all nodes at once, the arm
keeps the posture that it starts with and avoids singularities and joint limits, and the platform
moves no more than necessary: Gauss-Newton on a block-tridiagonal system.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_curve import ToolCurve

NODE_SPACING = 0.04  #: Largest distance between nodes [m of u]
MIN_INTERVALS = 8  #: Smallest number of intervals between nodes
#: Weight of each joint's distance from its start; that of wrist_3, which only rotates the tool, is
#: small.
CONFIGURATION_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.5, 1.0, 0.1])
#: Weights of the platform's derivatives by u, which smooth its motion over about 0.3 m
PLATFORM_RATE_WEIGHTS = np.array([3.0, 3.0, 1.0]) * 0.3**2
JOINT_RATE_WEIGHT = 0.3 * 0.3**2  #: Weight of the joints' derivatives by u
#: Weights of violated margins to singularities and joint limits: of the first solution, and of the
#: second one if the first violates a limit.
MARGIN_WEIGHTS = (1e2, 1e4)
#: Relative excess of margins at nodes over the minimum, which covers the path between nodes
NODE_MARGIN_RESERVE = 0.1
#: Margin to a singularity, relative to the minimum, below which it adds to the cost
MARGIN_ONSET = 2.0
LIMIT_MARGIN = 0.2  #: Margin to a joint limit below which it adds to the cost [rad]
MAX_ITERATIONS = 40  #: Largest number of Gauss-Newton iterations
CONVERGED_GAIN = 1e-4  #: Relative decrease of the cost at which the iteration has converged
#: Weight of the platform's jump where it is repositioned, for the initial guess
JUMP_WEIGHT = 30.0
SINGULARITIES = ("elbow", "wrist", "shoulder")  #: Names of the arm's singularities


@dataclass(frozen=True)
class RobotConfigurations(Validated):
    """Platform and arm at the nodes of a path."""

    at: Annotated[Array, Shape("n")]  #: (n + 1,) parameters u of the nodes, equally spaced [m]
    #: (n + 1, 3) poses of the platform, from its start on [m, m, rad]
    platform: Annotated[Array, Shape("n", 3)]
    #: (n + 1, 6) joint angles, unwrapped from the first on [rad]
    arm: Annotated[Array, Shape("n", 6)]


class RedundancyResolver:
    """Finds the motion of the platform for a path of the tool."""

    def __init__(
        self, model: WholeBodyModel, limits: AxisLimits, options: ToolPathOptions
    ) -> None:
        self._model, self._options = model, options
        self._lower, self._upper = limits.lower[3:], limits.upper[3:]
        self._names = limits.names[3:]

    def resolve(self, tool: ToolCurve, start: Array) -> RobotConfigurations:
        """Find the postures along a path that starts at the tool's pose for axes `start` (9,).

        Raises:
            InputError: The arm starts near a singularity, or the path leaves its reach, comes too
                close to a singularity or violates a joint limit; the message names the position.
        """
        problem = _ConfigurationProblem(self, tool, start)
        platform = problem.guess()
        min_margin = (1.0 + NODE_MARGIN_RESERVE) * self._options.singularity
        for margin_weight in MARGIN_WEIGHTS:
            configurations = problem.solution(platform, margin_weight)
            if not self._impossible(configurations.arm, start[3:], min_margin).any():
                break
            platform = configurations.platform
        self.require_possible(tool, configurations.at, configurations.arm, start[3:])
        return configurations

    def require_possible(self, tool: ToolCurve, at: Array, arm: Array, start: Array) -> None:
        """Require that joint angles (m, 6) at u (m,) are possible for an arm that starts at (6,).

        Raises:
            InputError: Joint angles are impossible; see :meth:`resolve`.
        """
        impossible = self._impossible(arm, start, self._options.singularity)
        if impossible.any():
            k = int(impossible.argmax())
            margins, _ = self.margins(arm[k : k + 1], self.signs(start))
            raise InputError(
                describe_position(tool, float(at[k])) + self.violation(arm[k], margins[0])
            )

    def _impossible(self, arm: Array, start: Array, min_margin: float) -> NDArray[np.bool_]:
        """Return (m,) bool: joint angles (m, 6) that are NaN, near-singular or beyond a limit."""
        margins, _ = self.margins(arm, self.signs(start))
        regular = (margins >= min_margin).all(axis=1)
        within = ((arm >= self._lower) & (arm <= self._upper)).all(axis=1)
        return np.asarray(~(regular & within), dtype=bool)

    def violation(self, arm: Array, margins: Array) -> str:
        """Describe why joint angles (6,) with margins (3,) to singularities are impossible."""
        if np.isnan(arm).any():
            return "out of the arm's reach"
        k = int(margins.argmin())
        if margins[k] < self._options.singularity:
            return f"too close to the {SINGULARITIES[k]}'s singularity, {_nearness(k, margins[k])}"
        excess = np.maximum(arm - self._upper, self._lower - arm)
        k = int(excess.argmax())
        limit = self._upper[k] if arm[k] > self._upper[k] else self._lower[k]
        return f"{self._names[k]} is at {arm[k]:.4g} rad, its limit is {limit:.4g} rad"

    def signs(self, start: Array) -> Array:
        """Return the signs (3,) of the sides of the singularities on which the arm starts.

        Raises:
            InputError: The arm starts too close to a singularity.
        """
        distances = self.margins(start[None], np.ones(3))[0][0]
        k = int(np.abs(distances).argmin())
        if not abs(distances[k]) >= self._options.singularity:
            raise InputError(
                f"the arm starts too close to the {SINGULARITIES[k]}'s singularity, "
                f"{_nearness(k, distances[k])}, at least {self._options.singularity:g} is needed"
            )
        signs: Array = np.sign(distances)
        return signs

    def margins(self, arm: Array, signs: Array) -> tuple[Array, Array]:
        """Return margins to the elbow's, wrist's and shoulder's singularity, and derivatives.

        Args:
            arm: Joint angles (m, 6) [rad].
            signs: (3,) sides of the singularities that count as positive.

        Returns:
            Margins (m, 3), and their derivatives (m, 3, 6) by the joint angles.
        """
        t = self._model.arm.table
        length = abs(t.a2) + abs(t.a3)
        upper, fore = arm[:, 1], arm[:, 1] + arm[:, 2]
        hand = fore + arm[:, 3]
        reach = t.a2 * np.cos(upper) + t.a3 * np.cos(fore) + t.d5 * np.sin(hand)
        wrist = t.d5 * np.cos(hand)
        elbow = wrist - t.a3 * np.sin(fore)
        slopes = np.zeros((len(arm), 3, 6))
        slopes[:, 0, 2] = np.cos(arm[:, 2])
        slopes[:, 1, 4] = np.cos(arm[:, 4])
        slopes[:, 2, 1] = (elbow - t.a2 * np.sin(upper)) / length
        slopes[:, 2, 2] = elbow / length
        slopes[:, 2, 3] = wrist / length
        values = np.column_stack([np.sin(arm[:, 2]), np.sin(arm[:, 4]), reach / length])
        return signs * values, signs[:, None] * slopes

    def hinges(self, arm: Array, signs: Array) -> tuple[Array, Array]:
        """Return the violations (m, 15) of the margins, 0 if kept, and derivatives (m, 15, 6)."""
        min_margin = self._options.singularity
        margins, slopes = self.margins(arm, signs)
        scale = (MARGIN_ONSET - 1.0) * min_margin
        rows = [
            (MARGIN_ONSET * min_margin - margins) / scale,
            (self._lower - arm) / LIMIT_MARGIN + 1.0,
            (arm - self._upper) / LIMIT_MARGIN + 1.0,
        ]
        values = np.concatenate(rows, axis=1)
        limit_slopes = np.broadcast_to(np.eye(6) / LIMIT_MARGIN, (len(arm), 6, 6))
        slopes = np.concatenate([-slopes / scale, -limit_slopes, limit_slopes], axis=1)
        violated = values > 0.0
        return np.where(violated, values, 0.0), slopes * violated[:, :, None]

    def angles(self, platform: Array, tool: Array, branch: int, near: Array) -> Array:
        """Return joint angles (m, 6) along a path, unwrapped from angles `near` (6,) on [rad]."""
        arm = self._model.arm_angles(platform, tool, branch, near)
        unwrapped: Array = np.unwrap(np.vstack([near, arm]), axis=0)[1:]
        return unwrapped

    def platform_derivative(self, q: Array) -> Array:
        """Return dq/dp (m, 6, 3): joint angles by the platform's pose while the tool stays."""
        jacobian = self._model.jacobian(q)
        derivative = np.linalg.solve(jacobian[:, :, 3:], -jacobian[:, :, :3])
        return np.asarray(derivative, dtype=float)


def solve_block_tridiagonal(middle: Array, beside: Array, right: Array) -> Array:
    """Solve a symmetric, positive definite block-tridiagonal system.

    Every second unknown is eliminated, then every second one of the remaining ones, and so on.

    Args:
        middle: Blocks (n, m, m) on the diagonal.
        beside: Blocks (n - 1, m, m) to the right of the diagonal; those to the left are their
            transposes.
        right: Right-hand side (n, m).

    Returns:
        Solution (n, m).
    """
    if len(middle) == 1:
        single = np.linalg.solve(middle, right[:, :, None])[:, :, 0]
        return np.asarray(single, dtype=float)
    # Unknowns 2 j + 1 are eliminated; only the last of them may have no successor.
    odd, count = middle[1::2], (len(middle) - 1) // 2
    before, after = beside[0::2], beside[1::2]  # 2 j to 2 j + 1, and 2 j + 1 to 2 j + 2
    packed = np.zeros((len(odd), middle.shape[1], 2 * middle.shape[1] + 1))
    size = middle.shape[1]
    packed[:, :, :size] = np.swapaxes(before, 1, 2)
    packed[:count, :, size : 2 * size] = after
    packed[:, :, -1] = right[1::2]
    solution = np.linalg.solve(odd, packed)
    to_before, to_after, constant = (
        solution[:, :, :size],
        solution[:, :, size : 2 * size],
        solution[:, :, -1],
    )
    inner, side = middle[0::2].copy(), right[0::2].copy()
    inner[: len(odd)] -= before @ to_before
    side[: len(odd)] -= (before @ constant[:, :, None])[:, :, 0]
    after_t = np.swapaxes(after, 1, 2)
    inner[1 : count + 1] -= after_t @ to_after[:count]
    side[1 : count + 1] -= (after_t @ constant[:count, :, None])[:, :, 0]
    even = solve_block_tridiagonal(inner, -(before[:count] @ to_after[:count]), side)
    result = np.empty_like(right)
    result[0::2] = even
    result[1::2] = constant - (to_before @ even[: len(odd), :, None])[:, :, 0]
    result[1 : 2 * count : 2] -= (to_after[:count] @ even[1 : count + 1, :, None])[:, :, 0]
    return result


class _ConfigurationProblem:
    def __init__(self, resolver: RedundancyResolver, tool: ToolCurve, start: Array) -> None:
        self._resolver, self._tool = resolver, tool
        self._model = resolver._model
        self._start, self._arm = start[:3], start[3:]
        self._signs = resolver.signs(self._arm)
        self._branch = self._model.arm.branch_of(self._arm)
        self.at: Array = np.linspace(
            0.0, tool.end, 1 + max(MIN_INTERVALS, math.ceil(tool.end / NODE_SPACING))
        )
        self._coordinates = tool.at(self.at)
        self._poses = tool.pose(self.at)
        space = float(self.at[1])
        # Sums over nodes approximate integrals over u.
        self._platform_weights: Array = PLATFORM_RATE_WEIGHTS / space**2
        self._margin_weight = MARGIN_WEIGHTS[0]
        self._joint_weights = np.full(6, JOINT_RATE_WEIGHT / space**2)

    def guess(self) -> Array:
        """Return poses (n + 1, 3) of a platform that moves with the tool.

        The platform is repositioned at nodes from which the arm cannot reach the tool.
        """
        tool = self._coordinates[:, [0, 1, 3]]  # x, y and psi of the tool
        platform = np.empty((len(self.at), 3))
        platform[0], first = self._start, 0
        offset = _relative(tool[0], self._start)
        while True:
            rest = slice(first + 1, None)
            platform[rest] = _carried(tool[rest], offset)
            impossible = np.flatnonzero(~self._possible(platform[rest], self._poses[rest]))
            if not len(impossible):
                return platform
            first += 1 + int(impossible[0])
            offset = self._placed(first, offset)
            platform[first] = _carried(tool[first : first + 1], offset)[0]

    def solution(self, platform: Array, margin_weight: float) -> RobotConfigurations:
        """Optimise the postures from an initial guess on.

        Args:
            platform: (n + 1, 3) poses of the platform from which all nodes are in reach.
        """
        self._margin_weight = margin_weight
        arm, cost = self._evaluated(platform)
        damping = 1e-6
        for _ in range(MAX_ITERATIONS):
            step = self._step(platform, arm, damping)
            fraction = 1.0
            while fraction > 0.01:
                tried = platform.copy()
                tried[1:] += fraction * step
                tried_arm, tried_cost = self._evaluated(tried)
                if tried_cost < cost:
                    break
                fraction *= 0.4
            else:
                if damping > 1.0:
                    break
                damping = 100.0 * damping
                continue
            gain = cost - tried_cost
            platform, arm, cost = tried, tried_arm, tried_cost
            damping = max(0.1 * damping, 1e-6)
            if (gain < CONVERGED_GAIN * cost and fraction == 1.0) or gain < 1e-12:
                break
        return RobotConfigurations(self.at, platform, np.vstack([self._arm, arm]))

    def _possible(self, platform: Array, poses: Array) -> NDArray[np.bool_]:
        arm = self._model.arm_angles(platform, poses, self._branch, self._arm)
        margins, _ = self._resolver.margins(arm, self._signs)
        return np.asarray((margins > self._resolver._options.singularity).all(axis=1), dtype=bool)

    def _placed(self, k: int, offset: Array) -> Array:
        """Return the cheapest pose (3,) of the platform, relative to the tool at node k.

        Args:
            offset: (3,) preferred pose, relative to the tool.

        Raises:
            InputError: The tool cannot be reached from any pose of the platform.
        """
        tool = self._poses[k : k + 1]
        mount = self._model.base(np.zeros(3))[:2, 3]
        table = self._model.arm.table
        longest = abs(table.a2) + abs(table.a3) + table.d4 + table.d5 + table.d6
        radius, angle, yaw = np.meshgrid(
            np.linspace(0.02, 1.0, 25) * longest,
            np.linspace(-math.pi, math.pi, 48, endpoint=False),
            offset[2] + np.linspace(-math.pi, math.pi, 8, endpoint=False),
            indexing="ij",
        )
        c, s = np.cos(yaw), np.sin(yaw)
        candidates = np.stack(
            [
                radius * np.cos(angle) - c * mount[0] + s * mount[1],
                radius * np.sin(angle) - s * mount[0] - c * mount[1],
                yaw,
            ],
            axis=-1,
        ).reshape(-1, 3)
        platform = _carried(
            np.broadcast_to(self._coordinates[k, [0, 1, 3]], candidates.shape), candidates
        )
        poses = np.broadcast_to(tool, (len(candidates), 4, 4))
        arm = self._model.arm_angles(platform, poses, self._branch, self._arm)
        margins, _ = self._resolver.margins(arm, self._signs)
        possible = (margins > self._resolver._options.singularity).all(axis=1)
        if not possible.any():
            least = np.where(np.isnan(margins), -np.inf, margins).min(axis=1)
            best = int(least.argmax())
            reason = self._resolver.violation(arm[best], margins[best])
            raise InputError(describe_position(self._tool, float(self.at[k])) + reason)
        candidates, arm = candidates[possible], arm[possible]
        hinges, _ = self._resolver.hinges(arm, self._signs)
        cost = (CONFIGURATION_WEIGHTS * (arm - self._arm) ** 2).sum(axis=1) + MARGIN_WEIGHTS[0] * (
            hinges**2
        ).sum(axis=1)
        cost += JUMP_WEIGHT * ((candidates - offset) ** 2).sum(axis=1)
        cheapest: Array = candidates[int(cost.argmin())]
        return cheapest

    def _evaluated(self, platform: Array) -> tuple[Array, float]:
        """Return joint angles (n, 6) of all nodes but the first, and the cost (or infinity)."""
        arm = self._resolver.angles(platform[1:], self._poses[1:], self._branch, self._arm)
        if np.isnan(arm).any():
            return arm, math.inf
        hinges, _ = self._resolver.hinges(arm, self._signs)
        steps = np.diff(platform, axis=0)
        joint_steps = np.diff(np.vstack([self._arm, arm]), axis=0)
        cost = (
            (CONFIGURATION_WEIGHTS * (arm - self._arm) ** 2).sum()
            + self._margin_weight * (hinges**2).sum()
            + (self._platform_weights * steps**2).sum()
            + (self._joint_weights * joint_steps**2).sum()
        )
        return arm, float(cost)

    def _step(self, platform: Array, arm: Array, damping: float) -> Array:
        """Return the Gauss-Newton step (n, 3) of all nodes but the first."""
        q = np.hstack([platform[1:], arm])
        slope = self._resolver.platform_derivative(q)
        slope_t = np.swapaxes(slope, 1, 2)
        hinges, hinge_slopes = self._resolver.hinges(arm, self._signs)
        weights = self._margin_weight * (np.swapaxes(hinge_slopes, 1, 2) @ hinge_slopes)
        gradient = self._margin_weight * (hinges[:, None, :] @ hinge_slopes)[:, 0]
        gradient += CONFIGURATION_WEIGHTS * (arm - self._arm)
        ends = np.full((len(arm), 1), 2.0)
        ends[-1] = 1.0
        weights[:, range(6), range(6)] += CONFIGURATION_WEIGHTS + ends * self._joint_weights
        joint_steps = np.diff(np.vstack([self._arm, arm]), axis=0) * self._joint_weights
        steps = np.diff(platform, axis=0) * self._platform_weights
        gradient += joint_steps
        gradient[:-1] -= joint_steps[1:]
        right = (slope_t @ gradient[:, :, None])[:, :, 0] + steps
        right[:-1] -= steps[1:]
        middle = slope_t @ weights @ slope
        middle[:, range(3), range(3)] += ends * self._platform_weights + damping
        beside = -(slope_t[:-1] * self._joint_weights) @ slope[1:]
        beside[:, range(3), range(3)] -= self._platform_weights
        return -solve_block_tridiagonal(middle, beside, right)


def describe_position(tool: ToolCurve, u: float) -> str:
    """Describe the point of the path at u [m] by the nearest of the given poses."""
    x, y, z = tool.position(u).tolist()
    k = tool.pose_index(u)
    label = "on the way to pose 0" if k == 0 else f"near pose {k - 1}"
    return f"{label} of the path, with the tool at ({x:.3f}, {y:.3f}, {z:.3f}) m: "


def _nearness(k: int, value: float) -> str:
    margin = ("the sine of the elbow", "the sine of wrist_2", "the wrist's share of the reach")[k]
    return f"{margin} is {abs(value):.3g}"


def _relative(tool: Array, platform: Array) -> Array:
    c, s = math.cos(tool[2]), math.sin(tool[2])
    x, y, yaw = (platform - tool).tolist()
    return np.array([c * x + s * y, c * y - s * x, yaw])


def _carried(tool: Array, offset: Array) -> Array:
    result: Array = tool + offset
    c, s = np.cos(tool[:, 2]), np.sin(tool[:, 2])
    result[:, 0] = tool[:, 0] + c * offset[..., 0] - s * offset[..., 1]
    result[:, 1] = tool[:, 1] + s * offset[..., 0] + c * offset[..., 1]
    return result
