"""Where the platform goes while the tool follows a path: the redundancy of nine axes resolved.

The platform's poses at nodes along the path are what is sought; the arm's angles follow from them
and the tool in closed form, dq/dp = -J_arm^-1 J_platform. Over all nodes at once the arm keeps
the shape that it starts with, keeps away from singularities and from its joints' limits, and the
platform moves no more than that takes: Gauss-Newton on a block-tridiagonal system.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.body.tool_curve import ToolCurve
from omniman_ros.core.body.tridiagonal import solved
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.axis_limits import AxisLimits

Array = NDArray[np.float64]

SPACING = 0.04
"""Longest way between nodes [m of u]."""
FEWEST = 8
"""Spaces between nodes."""
SHAPE = np.array([1.0, 1.0, 1.0, 0.5, 1.0, 0.1])
"""Weight of each joint's way from where it started; what turns about the tool is cheap."""
TRAVEL = np.array([3.0, 3.0, 1.0]) * 0.3**2
"""Weight of the platform's rates per u: over about 0.3 m it evens out what the tool does."""
BENDING = 0.3 * 0.3**2
"""Weight of the joints' rates per u."""
HINGES = (1e2, 1e4)
"""Weights of a margin that is used up, of a singularity's or a joint's limit: at first, and if
one is passed."""
ENOUGH = 0.1
"""Share by which margins at nodes are more than the least, for what is between them."""
KNEE = 2.0
"""Margins to singularities count below so many times the least one."""
LIMIT_MARGIN = 0.2
"""Margins to joints' limits count below it [rad]."""
ROUNDS = 40
SETTLED = 1e-4
"""Relative gain of a round that is the last."""
NEAR = 30.0
"""Weight of how far the platform jumps where it is placed anew, for the first guess."""
SINGULARITIES = ("elbow", "wrist", "shoulder")


@dataclass(frozen=True)
class Postures:
    """Platform and arm at nodes.

    Attributes:
        at: (n + 1,) u of the nodes, equally spaced [m].
        platform: (n + 1, 3) the first is where it starts.
        arm: (n + 1, 6) joint angles, unwrapped from the first on [rad].
    """

    at: Array
    platform: Array
    arm: Array


class PostureResolver:
    """Finds the platform's way for a path of the tool.

    Args:
        model: Kinematics.
        limits: Of the nine axes.
        options: Least margins to singularities.
    """

    def __init__(self, model: BodyModel, limits: AxisLimits, options: ToolPathOptions) -> None:
        self._model, self._options = model, options
        self._lower, self._upper = limits.lower[3:], limits.upper[3:]
        self._names = limits.names[3:]

    def resolve(self, tool: ToolCurve, start: Array) -> Postures:
        """Postures along a path that begins at the tool of the start (9,).

        Raises:
            InputError: The arm starts near a singularity, or the path leaves its reach, nears
                a singularity or needs more of a joint than there is; the place is named.
        """
        problem = _Problem(self, tool, start)
        platform = problem.guess()
        for hinge in HINGES:
            found = problem.solution(platform, hinge)
            if not self._bad(
                found.arm, start[3:], (1.0 + ENOUGH) * self._options.singularity
            ).any():
                break
            platform = found.platform
        self.demand(tool, found.at, found.arm, start[3:])
        return found

    def demand(self, tool: ToolCurve, at: Array, arm: Array, start: Array) -> None:
        """Demand that arm angles (m, 6) at u (m,) are possible; those of the start are (6,).

        Raises:
            InputError: They are not; see :meth:`resolve`.
        """
        bad = self._bad(arm, start, self._options.singularity)
        if bad.any():
            k = int(bad.argmax())
            margins, _ = self.margins(arm[k : k + 1], self.signs(start))
            raise InputError(place(tool, float(at[k])) + self.why(arm[k], margins[0]))

    def _bad(self, arm: Array, start: Array, least: float) -> NDArray[np.bool_]:
        """Which joint angles (m, 6) are impossible, NaN among them."""
        margins, _ = self.margins(arm, self.signs(start))
        good = (margins >= least).all(axis=1)
        within = ((arm >= self._lower) & (arm <= self._upper)).all(axis=1)
        return np.asarray(~(good & within), dtype=bool)

    def why(self, arm: Array, margins: Array) -> str:
        """What forbids joint angles (6,) with margins (3,) to singularities."""
        if np.isnan(arm).any():
            return "out of the arm's reach"
        k = int(margins.argmin())
        if margins[k] < self._options.singularity:
            return f"too near to the {SINGULARITIES[k]}'s singularity, {_nearness(k, margins[k])}"
        over = np.maximum(arm - self._upper, self._lower - arm)
        k = int(over.argmax())
        limit = self._upper[k] if arm[k] > self._upper[k] else self._lower[k]
        return f"{self._names[k]} is at {arm[k]:.4g} rad, its limit is {limit:.4g} rad"

    def signs(self, start: Array) -> Array:
        """Sides (3,) of the singularities that the arm starts on.

        Raises:
            InputError: It starts too near to one.
        """
        distances = self.margins(start[None], np.ones(3))[0][0]
        k = int(np.abs(distances).argmin())
        if not abs(distances[k]) >= self._options.singularity:
            raise InputError(
                f"the arm starts too near to the {SINGULARITIES[k]}'s singularity, "
                f"{_nearness(k, distances[k])}, at least {self._options.singularity:g}"
            )
        signs: Array = np.sign(distances)
        return signs

    def margins(self, arm: Array, signs: Array) -> tuple[Array, Array]:
        """Distances (m, 3) from the elbow's, wrist's and shoulder's singularity, and slopes.

        Args:
            arm: Joint angles (m, 6) [rad].
            signs: (3,) sides that count as positive.

        Returns:
            The distances, and their derivatives (m, 3, 6) by the joint angles.
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
        """How far (m, 15) margins are used up, 0 where they are not; and slopes (m, 15, 6)."""
        least = self._options.singularity
        margins, slopes = self.margins(arm, signs)
        scale = (KNEE - 1.0) * least
        rows = [
            (KNEE * least - margins) / scale,
            (self._lower - arm) / LIMIT_MARGIN + 1.0, (arm - self._upper) / LIMIT_MARGIN + 1.0,
        ]  # fmt: skip
        values = np.concatenate(rows, axis=1)
        side = np.broadcast_to(np.eye(6) / LIMIT_MARGIN, (len(arm), 6, 6))
        slopes = np.concatenate([-slopes / scale, -side, side], axis=1)
        used = values > 0.0
        return np.where(used, values, 0.0), slopes * used[:, :, None]

    def angles(self, platform: Array, tool: Array, branch: int, near: Array) -> Array:
        """Joint angles (m, 6) along a path, without jumps by whole turns from `near` (6,) on."""
        arm = self._model.arm_angles(platform, tool, branch, near)
        unwrapped: Array = np.unwrap(np.vstack([near, arm]), axis=0)[1:]
        return unwrapped

    def slope(self, q: Array) -> Array:
        """How the arm follows the platform while the tool stays, dq/dp (m, 6, 3)."""
        jacobian = self._model.jacobian(q)
        found = np.linalg.solve(jacobian[:, :, 3:], -jacobian[:, :, :3])
        return np.asarray(found, dtype=float)


class _Problem:
    """One path."""

    def __init__(self, resolver: PostureResolver, tool: ToolCurve, start: Array) -> None:
        self._resolver, self._tool = resolver, tool
        self._model = resolver._model
        self._start, self._arm = start[:3], start[3:]
        self._signs = resolver.signs(self._arm)
        self._branch = self._model.arm.branch_of(self._arm)
        self.at: Array = np.linspace(0.0, tool.end, 1 + max(FEWEST, math.ceil(tool.end / SPACING)))
        self._coordinates = tool.at(self.at)
        self._poses = tool.pose(self.at)
        space = float(self.at[1])
        # Sums over nodes stand for integrals over u.
        self._travel: Array = TRAVEL / space**2
        self._hinge = HINGES[0]
        self._bending = np.full(6, BENDING / space**2)

    def guess(self) -> Array:
        """The platform (n + 1, 3) carried along with the tool, placed anew where that fails."""
        seen = self._coordinates[:, [0, 1, 3]]
        platform = np.empty((len(self.at), 3))
        platform[0], first = self._start, 0
        offset = _relative(seen[0], self._start)
        while True:
            rest = slice(first + 1, None)
            platform[rest] = _carried(seen[rest], offset)
            bad = np.flatnonzero(~self._possible(platform[rest], self._poses[rest]))
            if not len(bad):
                return platform
            first += 1 + int(bad[0])
            offset = self._placed(first, offset)
            platform[first] = _carried(seen[first : first + 1], offset)[0]

    def solution(self, platform: Array, hinge: float) -> Postures:
        """The best postures from a guess on.

        Args:
            platform: (n + 1, 3) from which all nodes are in reach.
            hinge: Weight of margins that are used up.
        """
        self._hinge = hinge
        arm, cost = self._evaluated(platform)
        damping = 1e-6
        for _ in range(ROUNDS):
            step = self._step(platform, arm, damping)
            share = 1.0
            while share > 0.01:
                tried = platform.copy()
                tried[1:] += share * step
                tried_arm, tried_cost = self._evaluated(tried)
                if tried_cost < cost:
                    break
                share *= 0.4
            else:
                if damping > 1.0:
                    break
                damping = 100.0 * damping
                continue
            gain = cost - tried_cost
            platform, arm, cost = tried, tried_arm, tried_cost
            damping = max(0.1 * damping, 1e-6)
            if gain < SETTLED * cost and share == 1.0 or gain < 1e-12:
                break
        return Postures(self.at, platform, np.vstack([self._arm, arm]))

    # ---- parts ------------------------------------------------------------------------------

    def _possible(self, platform: Array, poses: Array) -> NDArray[np.bool_]:
        arm = self._model.arm_angles(platform, poses, self._branch, self._arm)
        margins, _ = self._resolver.margins(arm, self._signs)
        return np.asarray((margins > self._resolver._options.singularity).all(axis=1), dtype=bool)

    def _placed(self, k: int, offset: Array) -> Array:
        """Where (3,) the platform can be, seen from the tool at node k, nearest in cost.

        Raises:
            InputError: Nowhere.
        """
        tool = self._poses[k : k + 1]
        height = self._model.base(np.zeros(3))[:2, 3]
        table = self._model.arm.table
        longest = abs(table.a2) + abs(table.a3) + table.d4 + table.d5 + table.d6
        radius, angle, turn = np.meshgrid(
            np.linspace(0.02, 1.0, 25) * longest,
            np.linspace(-math.pi, math.pi, 48, endpoint=False),
            offset[2] + np.linspace(-math.pi, math.pi, 8, endpoint=False), indexing="ij",
        )  # fmt: skip
        c, s = np.cos(turn), np.sin(turn)
        tries = np.stack(
            [
                radius * np.cos(angle) - c * height[0] + s * height[1],
                radius * np.sin(angle) - s * height[0] - c * height[1], turn,
            ], axis=-1,
        ).reshape(-1, 3)  # fmt: skip
        platform = _carried(np.broadcast_to(self._coordinates[k, [0, 1, 3]], tries.shape), tries)
        poses = np.broadcast_to(tool, (len(tries), 4, 4))
        arm = self._model.arm_angles(platform, poses, self._branch, self._arm)
        margins, _ = self._resolver.margins(arm, self._signs)
        good = (margins > self._resolver._options.singularity).all(axis=1)
        if not good.any():
            least = np.where(np.isnan(margins), -np.inf, margins).min(axis=1)
            best = int(least.argmax())
            reason = self._resolver.why(arm[best], margins[best])
            raise InputError(place(self._tool, float(self.at[k])) + reason)
        tries, arm = tries[good], arm[good]
        hinges, _ = self._resolver.hinges(arm, self._signs)
        cost = (SHAPE * (arm - self._arm) ** 2).sum(axis=1) + HINGES[0] * (hinges**2).sum(axis=1)
        cost += NEAR * ((tries - offset) ** 2).sum(axis=1)
        best_try: Array = tries[int(cost.argmin())]
        return best_try

    def _evaluated(self, platform: Array) -> tuple[Array, float]:
        """Arm angles (n, 6) of all nodes but the first, and the cost; infinite if it cannot be."""
        arm = self._resolver.angles(platform[1:], self._poses[1:], self._branch, self._arm)
        if np.isnan(arm).any():
            return arm, math.inf
        hinges, _ = self._resolver.hinges(arm, self._signs)
        steps, turns = np.diff(platform, axis=0), np.diff(np.vstack([self._arm, arm]), axis=0)
        cost = (
            (SHAPE * (arm - self._arm) ** 2).sum() + self._hinge * (hinges**2).sum()
            + (self._travel * steps**2).sum() + (self._bending * turns**2).sum()
        )  # fmt: skip
        return arm, float(cost)

    def _step(self, platform: Array, arm: Array, damping: float) -> Array:
        """Change (n, 3) of all nodes but the first."""
        q = np.hstack([platform[1:], arm])
        slope = self._resolver.slope(q)
        back = np.swapaxes(slope, 1, 2)
        hinges, pulls = self._resolver.hinges(arm, self._signs)
        weights = self._hinge * (np.swapaxes(pulls, 1, 2) @ pulls)
        force = self._hinge * (hinges[:, None, :] @ pulls)[:, 0] + SHAPE * (arm - self._arm)
        ends = np.full((len(arm), 1), 2.0)
        ends[-1] = 1.0
        weights[:, range(6), range(6)] += SHAPE + ends * self._bending
        turns = np.diff(np.vstack([self._arm, arm]), axis=0) * self._bending
        steps = np.diff(platform, axis=0) * self._travel
        force += turns
        force[:-1] -= turns[1:]
        right = (back @ force[:, :, None])[:, :, 0] + steps
        right[:-1] -= steps[1:]
        middle = back @ weights @ slope
        middle[:, range(3), range(3)] += ends * self._travel + damping
        beside = -(back[:-1] * self._bending) @ slope[1:]
        beside[:, range(3), range(3)] -= self._travel
        return -solved(middle, beside, right)


def place(tool: ToolCurve, u: float) -> str:
    """Words for a place of the path, with the nearest of the given poses."""
    x, y, z = tool.place(u).tolist()
    k = tool.pose_index(u)
    label = "on the way to pose 0" if k == 0 else f"near pose {k - 1}"
    return f"{label} of the path, with the tool at ({x:.3f}, {y:.3f}, {z:.3f}) m: "


def _nearness(k: int, value: float) -> str:
    what = ("the sine of the elbow", "the sine of wrist_2", "the wrist's share of the reach")[k]
    return f"{what} is {abs(value):.3g}"


def _relative(tool: Array, platform: Array) -> Array:
    """Platform (3,) seen from a tool x, y, psi (3,)."""
    c, s = math.cos(tool[2]), math.sin(tool[2])
    x, y, turn = (platform - tool).tolist()
    return np.array([c * x + s * y, c * y - s * x, turn])


def _carried(tool: Array, offset: Array) -> Array:
    """Platforms (m, 3) that tools (m, 3) see at offsets (3,) or (m, 3)."""
    result: Array = tool + offset
    c, s = np.cos(tool[:, 2]), np.sin(tool[:, 2])
    result[:, 0] = tool[:, 0] + c * offset[..., 0] - s * offset[..., 1]
    result[:, 1] = tool[:, 1] + s * offset[..., 0] + c * offset[..., 1]
    return result
