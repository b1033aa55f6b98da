"""A published reactive way of the whole body, beside the planner's: NEO for mobile manipulators.

J. Haviland and P. Corke, "NEO: A Novel Expeditious Optimisation Algorithm for Reactive Motion
Control of Manipulators" (RA-L 2021), and "A Holistic Approach to Reactive Mobile Manipulation"
(RA-L 2022). A cycle solves one quadratic program in the rates q' of the nine axes and a slack d of
the tool's twist:

    minimise    q'q' / 2 + w_d d'd / 2 - c (dm/dq) q'
    subject to  J q' + d = v,  dh/dt >= -xi (h - h_s) / (h_i - h_s) for each gap h < h_i,

and to the limits of positions, rates, accelerations and wheels. m = |det J_arm| is the arm's
manipulability; v is the twist along the path plus a proportional feedback; w_d grows as the tool's
error falls. The slack is free, so that the program is solved in q' alone, with d = v - J q'.

Unlike in the papers, accelerations are limited. A damper asks for no more than they allow. The
influence distance of what moves is so large that they suffice at a walking speed. Without a
solution, the robot brakes. The limit of a vector is shared equally by its two components.
"""

import math

import numpy as np

from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import AXES
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.mpc.quadratic_program import INFINITY, QuadraticProgram, SolverError
from omniman_ros.planning.whole_body.body_gaps import MOVING, BodyGaps
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.linearisation import DIAGONAL
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.redundancy import COORDINATES, Configurations

#: Weight w_d over that of rates, times the tool's error, and the least error [m] that counts
SLACK_WEIGHT, LEAST_ERROR = 20.0, 0.002
MANIPULABILITY_WEIGHT = 2.0  #: Weight of the growth of manipulability
FEEDBACK = 2.0  #: Rate of the tool's error that is wanted, over the error [1/s]
LAG = 0.05  #: Error of the tool with which the path waits for it [m]
ROWS = 24  #: Number of gaps that have dampers
#: Fraction of what the accelerations allow that a damper of each kind asks for at most
#: Fraction of the limits on acceleration that a cycle uses; the rest is for joining previews
ACCELERATION = 0.6
ATTAINED = np.array([0.5, 0.5, 0.1])
#: Influence distances [m], and closing speeds there [m/s], of gaps to the robot itself, to what
#: stands, and to what moves
INFLUENCE, CLOSING = np.array([0.1, 0.6, 2.0]), np.array([0.5, 1.0, 1.0])
#: Distance [rad] over which a joint slows down, and that to its end at which it stops
JOINT_INFLUENCE, JOINT_STOP = 0.8, 0.1
ROUND_OFF = 1e-9  #: Distance from the end of the path that is round-off [m]
DIFFERENCE = 1e-4  #: Step of numerical derivatives [rad, s]
ARRIVED, REST = 0.005, 0.005  #: Distance [m] and speed [m/s] of a tool that rests at the end


class ReactiveBody:
    """Leads the tool along a path by one small program a cycle.

    Args:
        poses: Poses (k, 4, 4) of `tool0` in odom; the tool moves straight to the first.
        start: Axes (9,) at the start, at rest.

    Attributes:
        model: Kinematics of the robot.
        path: Path of the tool.
        place: Parameter of the path where the tool should be [m].
        braked: Number of cycles whose program had no solution.

    Raises:
        InputError: The input is invalid, or the path is too far away.
        SolverError: casadi has no HPIPM.
    """

    def __init__(self, setup: BodySetup, poses: Array, start: Array) -> None:
        self.model = WholeBodyModel(setup.description.mount)
        ToolPlanner(self.model, setup.limits, setup.path).require_valid(poses, start)
        self.path = ToolCurve(np.concatenate([self.model.forward(start)[None], poses]), setup.path)
        self.place, self.braked = 0.0, 0
        self._speed, self._left, self._tool_speed = 0.0, math.inf, 0.0
        self._rates: Array = np.zeros(AXES)
        self._options, self._limits, o = setup.path, setup.limits, setup.dodge
        self._gaps = BodyGaps(setup.description, setup.tool, setup.load, o.spacing, o.time_gap)
        self._stop = np.array([o.own_clearance, o.clearance, o.moving_clearance])
        vector = np.array([DIAGONAL] * 2 + [1.0] * (1 + JOINTS))
        self._fastest: Array = vector * setup.limits.velocity
        self._change: Array = PERIOD * ACCELERATION * vector * setup.limits.acceleration
        count = ROWS + len(setup.limits.wheels)
        self._program = QuadraticProgram.of_masks(
            np.ones((AXES, AXES)),
            np.ones((count, AXES)),
            {"N": 1, "nx": [0, 0], "nu": [AXES, 0], "ng": [count, 0]},
        )

    @property
    def is_completed(self) -> bool:
        """Whether the tool rests at the end of the path, as the last cycle saw it."""
        is_there = self.path.end - self.place < ROUND_OFF and self._left <= ARRIVED
        return is_there and self._tool_speed <= REST

    def cycle(self, axes: Array, time: float, around: ObstacleSnapshot) -> Array:
        """Return the rates (9,) of the next period for axes (9,) at a time [s]."""
        jacobian = self.model.jacobian(axes)
        error = _error(self.model.forward(axes), self.path.pose(np.array([self.place]))[0])
        self._left, size = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error))
        twist = self._along(size) + FEEDBACK * error
        weight = SLACK_WEIGHT / max(size, LEAST_ERROR)
        hessian = np.eye(AXES) + weight * jacobian.T @ jacobian
        gradient = -weight * jacobian.T @ twist
        gradient[3:] -= MANIPULABILITY_WEIGHT * self._manipulability_gradient(axes[3:])
        bounds = self._bounds(axes)
        rows, low = self._dampers(axes, time, around, bounds)
        wheels = self._limits.wheels @ planar_transform(axes[:3])[:3, :3].T
        rows = np.vstack([rows, np.pad(wheels, ((0, 0), (0, JOINTS)))])
        fastest = np.full(len(wheels), self._limits.wheel_speed)
        low, high = np.append(low, -fastest), np.append(np.full(ROWS, INFINITY), fastest)
        try:
            self._rates = self._program.solve_entries(
                hessian.ravel(), gradient, rows.ravel(order="F"), (low, high, *bounds)
            )
        except SolverError:
            self.braked += 1
            self._rates = self._rates - np.clip(self._rates, -self._change, self._change)
        self._tool_speed = float(np.linalg.norm((jacobian @ self._rates)[:3]))
        return self._rates.copy()

    def _along(self, error: float) -> Array:
        """Return the twist (6,) along the path, on which the place moves a period on."""
        options, left = self._options, self.path.end - self.place
        change = PERIOD * options.linear_acceleration
        braking = math.sqrt(0.25 * change**2 + 2.0 * options.linear_acceleration * left)
        braking = max(braking - 0.5 * change, 0.1 * change)
        wanted = options.linear_velocity * min(max(2.0 * (1.0 - error / LAG), 0.0), 1.0)
        self._speed = min(wanted, self._speed + change, braking, left / PERIOD)
        before, self.place = self.place, self.place + PERIOD * self._speed
        middle = np.array([0.5 * (before + self.place)])
        result: Array = self._speed * self.path.motion(middle)[1][0]
        return result

    def _manipulability_gradient(self, arm: Array) -> Array:
        """Return the derivatives (6,) of |det J_arm| by the joint angles (6,)."""
        steps = DIFFERENCE * np.eye(JOINTS)
        jacobians = self.model.arm.jacobian(arm + np.concatenate([steps, -steps]))
        ahead, behind = np.split(np.abs(np.linalg.det(jacobians)), 2)
        result: Array = (ahead - behind) / (2.0 * DIFFERENCE)
        return result

    def _dampers(
        self, axes: Array, time: float, around: ObstacleSnapshot, bounds: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return rows (R, 9) and the least values (R,) of their products with the rates.

        The gaps are those of four copies of the configuration, each with four coordinates. The
        first three coordinates move the platform; in the second copy, each moves one of the first
        four joints besides, and in the third, the last two move the last two joints. In the last
        copy, what moves is where it was shortly before.
        """
        q = np.tile(axes, (4, 1))
        frames = self.model.arm.frames(q[:, 3:])
        by_joints = np.zeros((4, JOINTS, COORDINATES))
        by_joints[1, :COORDINATES] = by_joints[2, 2:] = np.eye(COORDINATES)
        at = Configurations(
            z=np.zeros((4, COORDINATES)),
            q=q,
            rates=by_joints,
            frames=frames,
            jacobian=self.model.jacobian_of(q, frames),
            bend=np.zeros((4, 6)),
        )
        ages = np.full(4, max(time - around.time, 0.0))
        ages[3] -= DIFFERENCE
        obstacles = len(around.standing) + len(around.moving)
        # More rows than there are gaps keep their order, which is the same for all copies.
        count = ROWS + (len(self._gaps.names) + len(self._gaps.rectangles)) * obstacles
        found = self._gaps.rows(at, around, ages, float(INFLUENCE.max()), count)
        gap, kind = found.gap[0], found.kind[0]
        platform, first, last = found.slope[:3]
        slopes = np.hstack([platform[:, :3], first - platform, (last - platform)[:, 2:]])
        drift = np.where(kind == MOVING, (gap - found.gap[3]) / DIFFERENCE, 0.0)
        stop, influence = self._stop[kind], INFLUENCE[kind]
        damping = CLOSING[kind] / (influence - stop)
        least = -damping * (gap - stop) - drift
        middle, half = 0.5 * (bounds[0] + bounds[1]), 0.5 * (bounds[1] - bounds[0])
        least = np.minimum(least, slopes @ middle + ATTAINED[kind] * (np.abs(slopes) @ half))
        is_far = gap >= influence
        slopes[is_far], least[is_far] = 0.0, -INFINITY
        nearest = np.argsort(gap - influence)[:ROWS]
        return slopes[nearest], np.maximum(least[nearest], -INFINITY)

    def _bounds(self, axes: Array) -> tuple[Array, Array]:
        """Return least and largest rates (9,): speeds, accelerations, and dampers of joints."""
        room = np.stack([axes - self._limits.lower, self._limits.upper - axes])
        toward = self._fastest * np.minimum((room - JOINT_STOP) / JOINT_INFLUENCE, 1.0)
        slower, faster = self._rates - self._change, self._rates + self._change
        return np.maximum(-toward[0], slower), np.minimum(toward[1], faster)


def _error(tool: Array, wanted: Array) -> Array:
    """Return the error (6,) of a tool's pose (4, 4), as a twist to the one that is wanted."""
    apart = 0.5 * np.cross(tool[:3, :3], wanted[:3, :3], axis=0).sum(axis=1)
    return np.concatenate([wanted[:3, 3] - tool[:3, 3], apart])
