"""Gauss-Newton steps of plans in the redundancy: costs and rows at a guess, and the step."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import Range
from omniman_ros.core.validated import Validated
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.corner_speeds import CornerSpeeds
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions
from omniman_ros.planning.whole_body.platform_path import PlatformPath
from omniman_ros.planning.whole_body.program import (
    LIMITS,
    MOVING,
    STANDING,
    Quadratic,
    ReducedProgram,
    StageRows,
)
from omniman_ros.planning.whole_body.redundancy import (
    COORDINATES,
    PATH_PARAMETER,
    BodyRedundancy,
    Configurations,
    SingularityMargins,
)

#: Largest changes of the redundancy coordinates in one step [m, m, rad, m]
TRUST = np.array([0.12, 0.12, 0.2, 0.12])
FREE_TRUST = 0.15  #: That of those of a free orientation [rad]
BOUND_TRUST = 0.4  #: Fraction of a coordinate's bound by which a step changes it at most
SLACK_LINEAR: Array = np.array([2e3, 2e3, 2e1])  #: Weights of the slack, by its class
SLACK_QUADRATIC: Array = np.array([2e4, 2e4, 3e3])  #: Weights of the squares of the slack
PROGRESS_WEIGHT = 8.0  #: Weight of the distance on the path from where the tool should be [1/m^2]
NEAR = 0.1  #: Distance from there below which that weight grows [m]
LEAST_DISTANCE = 0.004  #: Distance below which it does not grow any more [m]
#: Weights of the distance from the searched way [1/m^2, 1/rad^2]
PATH_WEIGHTS = np.array([4.0, 4.0, 1.5])
FREE_PATH_WEIGHT = 0.3  #: Weight of a free orientation's distance from the searched one, of 1 rad
RATE_WEIGHT = 0.05  #: Weight of the joints' rates [s^2/rad^2]
#: Weights of the rates of the coordinates [s^2/m^2, s^2/rad^2]
PLATFORM_RATE_WEIGHTS = np.array([0.5, 0.5, 0.2, 0.0])
#: Weights of the accelerations of the coordinates
CONTROL_WEIGHTS: Array = np.array([0.15, 0.15, 0.05, 0.3])
#: Weights of the rates and accelerations of a free orientation [s^2/rad^2, s^4/rad^2]
FREE_RATE_WEIGHT, FREE_CONTROL_WEIGHT = 0.05, 0.02
GAP_CUTOFF = 0.6  #: Gap beyond which an obstacle does not matter to a plan [m]
OWN_CLEARANCE = 0.02  #: Gap that plans keep between parts of the robot [m]
#: Excess of the tip-over margin that plans keep [m], and that which counts as one limit [m]
TIP_OVER_RESERVE, TIP_OVER_SCALE = 0.01, 0.1
ONSET = 1.3  #: Margin to singularities that plans keep, relative to the least one
ANGLE_RESERVE = 0.05  #: Distance that plans keep from the ends of the joints [rad]
#: Largest distance of a joint from its start where the tool's orientation is free [rad]: half a
#: revolution is the end of a branch, which a rotation of the tool alone reaches
ROOM = math.pi - 0.2
#: Fractions of a step that are tried until all of it is within the arm's reach
STEPS = (1.0, 0.5, 0.25)
DIAGONAL = np.sqrt(0.5)  #: Fraction of the limit of a vector that each of its components may use
#: Half width of the bounds on the rates at the end of a plan, where it rests [m/s, rad/s]: between
#: equal bounds there is no interior, and HPIPM's fast mode often fails
REST_BAND = 1e-6


@dataclass(frozen=True)
class PathLimits(Validated):
    """Limits of the motion along a path."""

    speed: float  #: Largest rate of the path parameter [m/s]
    acceleration: float  #: Its largest acceleration [m/s^2]
    reserve: float  #: Fraction of the axes' limits that is left free
    #: Largest rate of the coordinates of a free orientation [rad/s], and acceleration [rad/s^2]
    turning: Annotated[tuple[float, float], Range(low=0.0)]


class Linearisation:
    """Improves plans.

    Args:
        margins: The arm's margins to singularities; None: it may pass through them.
    """

    def __init__(
        self,
        redundancy: BodyRedundancy,
        gaps: BodyGaps,
        balance: BodyBalance,
        margins: SingularityMargins | None,
        limits: WholeBodyLimits,
        along: PathLimits,
        options: AvoidanceOptions,
    ) -> None:
        self._redundancy, self._gaps, self._margins = redundancy, gaps, margins
        self._balance, self._options = balance, options
        self._speed = along.speed
        available = 1.0 - along.reserve
        self._joint_speed: Array = available * options.joint_effort * limits.velocity[3:]
        self._joint_acceleration: Array = (
            available * options.joint_effort * limits.acceleration[3:]
        )
        self._wheels: Array = limits.wheels / (available * limits.wheel_speed)
        self._lower: Array = limits.lower[3:] + ANGLE_RESERVE
        self._upper: Array = limits.upper[3:] - ANGLE_RESERVE
        speed, yaw_rate = min(limits.velocity[0], limits.path_speeds[0]), limits.velocity[2]
        d = self._coordinates = len(redundancy.bound)
        free = d - COORDINATES
        if free:
            self._lower = np.maximum(self._lower, redundancy.centre - ROOM)
            self._upper = np.minimum(self._upper, redundancy.centre + ROOM)
        turn_rate, turn_acceleration = along.turning
        self._top = np.array(
            [DIAGONAL * speed, DIAGONAL * speed, yaw_rate, self._speed, *[turn_rate] * free]
        )
        self._hardest = np.array(
            [
                DIAGONAL * limits.acceleration[0],
                DIAGONAL * limits.acceleration[0],
                limits.acceleration[2],
                along.acceleration,
                *[turn_acceleration] * free,
            ]
        )
        self._trust = np.minimum([*TRUST, *[FREE_TRUST] * free], BOUND_TRUST * redundancy.bound)
        pull = redundancy.pull * PATH_WEIGHTS
        of_free = FREE_PATH_WEIGHT / np.minimum(redundancy.bound[COORDINATES:], 1.0) ** 2
        self._way_weights = np.append(pull, of_free)
        self._rate_weights = np.diag([*PLATFORM_RATE_WEIGHTS, *[FREE_RATE_WEIGHT] * free])
        self._control_weights = np.array([*CONTROL_WEIGHTS, *[FREE_CONTROL_WEIGHT] * free])
        self._corners = CornerSpeeds(
            redundancy.path.end, redundancy.bends, available * along.acceleration
        )
        count = options.gaps + 3 * len(self._lower) + len(self._wheels) + 3
        count += balance.edge_count + (0 if margins is None else 3)
        self._program = ReducedProgram(
            options.steps, options.step, count, SLACK_LINEAR, SLACK_QUADRATIC, d
        )

    def improved(
        self,
        z: Array,
        rates: Array,
        controls: Array,
        times: Array,
        way: PlatformPath,
        around: ObstacleSnapshot,
    ) -> tuple[Array, Array]:
        """Return a better plan: coordinates and rates (N + 1, d), at rest at the end.

        The guess has coordinates and rates (N + 1, d) at times (N + 1,), and accelerations (N, d)
        over the steps.

        Raises:
            SolverError: There is none: the guess is out of reach, or the program was not solved.
        """
        at = self._redundancy.configurations(z[1:])
        if not np.isfinite(at.rates).all():
            raise SolverError("the guess is out of the arm's reach, or singular")
        rows = StageRows.join(
            [
                self._gap_rows(at, around, times[1:] - around.time),
                self._arm_rows(at, rates[1:], controls),
                self._wheel_rows(at, rates[1:]),
                self._balance_rows(at, rates[1:], controls),
                self._path_rows(z[:, PATH_PARAMETER], rates[1:, PATH_PARAMETER]),
            ]
        )
        step = self._program.solve(rows, self._cost(at, z, rates, controls, way))
        # The dynamics are linear: a part of a step obeys them, too.
        for fraction in STEPS:
            better, better_rates = z.copy(), rates.copy()
            better[1:] += fraction * step.states[:, : self._coordinates]
            better_rates[1:] += fraction * step.states[:, self._coordinates :]
            better_rates[-1] = 0.0  # as that of the guess, but for REST_BAND
            if np.isfinite(self._redundancy.axes(better[1:])).all():
                break
        return better, better_rates

    def _cost(
        self, at: Configurations, z: Array, rates: Array, controls: Array, way: PlatformPath
    ) -> Quadratic:
        """Return the cost and the bounds at a guess."""
        o, n, end = self._options, len(controls), self._redundancy.path.end
        time = o.step * np.arange(1, n + 1)
        wanted = np.minimum(z[0, PATH_PARAMETER] + self._speed * time, end)
        d, size, bound = self._coordinates, 2 * self._coordinates, self._redundancy.bound
        led = [k for k in range(d) if k != PATH_PARAMETER]  # by the way
        pose, slope = way.at(z[1:, PATH_PARAMETER])
        by_z = np.tile(np.eye(d), (n, 1, 1))
        by_z[:, led, PATH_PARAMETER] = -slope
        off = np.empty((n, d))
        off[:, led] = z[1:, led] - pose
        off[:, PATH_PARAMETER] = z[1:, PATH_PARAMETER] - wanted
        weights = np.empty((n, 1, d))
        weights[..., led] = self._way_weights
        # Below NEAR the cost is about the distance, not its square: the robot does not creep.
        near = NEAR / np.clip(np.abs(off[:, PATH_PARAMETER]), LEAST_DISTANCE, NEAR)
        weights[:, 0, PATH_PARAMETER] = PROGRESS_WEIGHT * near
        hessian, gradient = np.zeros((n, size, size)), np.zeros((n, size))
        weighted = np.swapaxes(by_z, 1, 2) * weights
        hessian[:, :d, :d] = 2.0 * weighted @ by_z
        gradient[:, :d] = 2.0 * (weighted @ off[:, :, None])[:, :, 0]
        by_rate = np.swapaxes(at.rates, 1, 2)
        bend = 2.0 * RATE_WEIGHT * by_rate @ at.rates + 2.0 * self._rate_weights
        hessian[:, d:, d:] = bend
        gradient[:, d:] = (bend @ rates[1:, :, None])[:, :, 0]
        hessian[:, range(size), range(size)] += 1e-4
        states = np.empty((2, n, size))
        states[0, :, :d] = np.minimum(np.maximum(-self._trust, -bound - z[1:]), 0.0)
        states[1, :, :d] = np.maximum(np.minimum(self._trust, bound - z[1:]), 0.0)
        states[0, :, d:] = np.minimum(-self._top - rates[1:], 0.0)
        states[1, :, d:] = np.maximum(self._top - rates[1:], 0.0)
        states[0, :, d + PATH_PARAMETER] = np.minimum(-rates[1:, PATH_PARAMETER], 0.0)
        states[:, -1, d:] = -rates[-1] + np.array([[-REST_BAND], [REST_BAND]])
        control = np.stack(
            [
                np.minimum(-self._hardest - controls, 0.0),
                np.maximum(self._hardest - controls, 0.0),
            ]
        )
        bend = 2.0 * self._control_weights
        return Quadratic.unchecked(
            hessian=hessian,
            gradient=gradient,
            control_hessian=bend,
            control_gradient=bend * controls,
            control_bounds=control,
            state_bounds=states,
        )

    def _gap_rows(self, at: Configurations, around: ObstacleSnapshot, ages: Array) -> StageRows:
        """Return the rows of the nearest gaps."""
        o = self._options
        found = self._gaps.rows(at, around, ages, GAP_CUTOFF, o.gaps)
        clearance = np.array([OWN_CLEARANCE, o.clearance, o.moving_clearance])[found.kind]
        by_x = np.concatenate([found.slope, np.zeros_like(found.slope)], axis=2)
        return StageRows.unchecked(
            value=found.gap - clearance,
            by_x=by_x,
            by_u=np.zeros_like(found.slope),
            slack=np.array([STANDING, STANDING, MOVING])[found.kind],
        )

    def _arm_rows(self, at: Configurations, rates: Array, controls: Array) -> StageRows:
        """Return the rows of singularities, angles, rates and accelerations of the joints.

        Of a limit with two sides, the one counts that is nearer at the guess.
        """
        n, zeros = len(rates), np.zeros_like(at.rates)
        middle, half = 0.5 * (self._upper + self._lower), 0.5 * (self._upper - self._lower)
        limits = np.full((n, len(middle)), LIMITS)
        off = at.arm - middle
        sign = -np.sign(off)
        angles = StageRows.unchecked(
            value=half - np.abs(off),
            by_x=np.concatenate([sign[..., None] * at.rates, zeros], axis=2),
            by_u=zeros,
            slack=limits,
        )
        turning = (at.rates @ rates[:, :, None])[:, :, 0] / self._joint_speed
        sign = (-np.sign(turning) / self._joint_speed)[..., None]
        speeds = StageRows.unchecked(
            value=1.0 - np.abs(turning),
            by_x=np.concatenate([zeros, sign * at.rates], axis=2),
            by_u=zeros,
            slack=limits,
        )
        bending = (at.rates @ controls[:, :, None])[:, :, 0] + self._redundancy.drift(at, rates)
        bending /= self._joint_acceleration
        sign = (-np.sign(bending) / self._joint_acceleration)[..., None]
        accelerations = StageRows.unchecked(
            value=1.0 - np.abs(bending),
            by_x=np.concatenate([zeros, zeros], axis=2),
            by_u=sign * at.rates,
            slack=limits,
        )
        rows = [angles, speeds, accelerations]
        if self._margins is not None:
            margins, by_arm = self._margins.at(at.arm)
            by_z = by_arm @ at.rates
            singular = StageRows.unchecked(
                value=margins - ONSET * self._margins.least,
                by_x=np.concatenate([by_z, np.zeros_like(by_z)], axis=2),
                by_u=np.zeros_like(by_z),
                slack=np.full(margins.shape, LIMITS),
            )
            rows.append(singular)
        return StageRows.join(rows)

    def _path_rows(self, places: Array, speeds: Array) -> StageRows:
        """Return the rows of the speeds (N,) in bends of the path, and of its end.

        The body is at places (N + 1,). A bend between two nodes counts for both.
        """
        n, speed, distance = len(speeds), self._speed, self._speed * self._options.step
        ahead = np.append(places[2:], places[-1])
        cap = np.minimum(self._corners.cap(places[:-1], ahead), speed)
        before, slope = self._corners.approach(places[1:])
        left = self._redundancy.path.end - places[1:]
        d = self._coordinates
        by_x = np.zeros((n, 3, 2 * d))
        by_x[:, :2, d + PATH_PARAMETER] = -1.0 / speed
        by_x[:, 1, PATH_PARAMETER] = slope / speed
        by_x[:, 2, PATH_PARAMETER] = -1.0 / distance
        return StageRows.unchecked(
            value=np.column_stack(
                [(cap - speeds) / speed, (before - speeds) / speed, left / distance]
            ),
            by_x=by_x,
            by_u=np.zeros((n, 3, d)),
            slack=np.full((n, 3), LIMITS),
        )

    def _wheel_rows(self, at: Configurations, rates: Array) -> StageRows:
        """Return the rows of the wheels' speeds, CCTA 2017 (8)."""
        c, s = np.cos(at.z[:, 2]), np.sin(at.z[:, 2])
        to_robot = np.zeros((len(c), 3, 3))
        to_robot[:, 0, 0] = to_robot[:, 1, 1] = c
        to_robot[:, 0, 1], to_robot[:, 1, 0] = s, -s
        to_robot[:, 2, 2] = 1.0
        by_rate = self._wheels @ to_robot
        speed = (by_rate @ rates[:, :3, None])[:, :, 0]
        d = self._coordinates
        by_x = np.zeros((*speed.shape, 2 * d))
        by_x[:, :, d : d + 3] = -np.sign(speed)[..., None] * by_rate
        return StageRows.unchecked(
            value=1.0 - np.abs(speed),
            by_x=by_x,
            by_u=np.zeros((*speed.shape, d)),
            slack=np.full(speed.shape, LIMITS),
        )

    def _balance_rows(self, at: Configurations, rates: Array, controls: Array) -> StageRows:
        """Return the rows of the tip-over margins to the edges of the wheels' contacts."""
        found = self._balance.rows(at, rates, controls)
        least = self._options.tip_over_margin + TIP_OVER_RESERVE
        return StageRows.unchecked(
            value=(found.margin - least) / TIP_OVER_SCALE,
            by_x=np.concatenate([found.by_z, found.by_rate], axis=2) / TIP_OVER_SCALE,
            by_u=found.by_acceleration / TIP_OVER_SCALE,
            slack=np.full(found.margin.shape, LIMITS),
        )
