"""Cartesian path of the tool as a curve with a continuous second derivative.

The coordinates are x, y, z [m], psi, swing_x, swing_y [rad] with R = Rz(psi) exp(swing) R0, where
R0 is the first orientation and the swing's axis is horizontal: swing and twist about the vertical.
So psi can go through any number of revolutions, which the platform can follow, and only a tool
that is upside down relative to the first pose has no coordinates.

The parameter u is a length [m]: between two poses it is the larger of the tool's path length and
of LEVER times the change of psi and swing.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path import polyline
from omniman_ros.motion.path.axis_group import AxisGroup, max_utilisation
from omniman_ros.motion.path.curve import Curve
from omniman_ros.motion.whole_body.parameters import ToolPathOptions

#: Fractions of the tolerance for omitted poses, for corners, and for the average over u
ToleranceSplit = tuple[float, float, float]

ROTATION_LENGTH = 0.4  #: Length that corresponds to a rotation [m/rad]
FINE = (0.25, 0.5, 0.2)  #: Tolerance split for clean poses
COARSE = (0.7, 0.2, 0.08)  #: Tolerance split for noisy poses
#: Fraction of the poses that remains with COARSE, up to which the poses count as noisy
NOISY_FRACTION = 0.5
#: Second derivative for which no parabola needs to be longer than its straights [1/m]
MAX_BEND = 0.25
MAX_WINDOW = 0.02  #: Longest averaging window [m]
MAX_SWING = 3.0  #: Largest swing [rad]; near pi its axis jumps
MIN_LENGTH = 1e-4  #: Length below which there is no path to follow [m]
#: Swing [rad] below which series replace quotients; also the step of a numerical derivative
SMALL = 1e-5


class ToolCurve:
    """Coordinates as piecewise cubic, twice continuously differentiable polynomials in u.

    Corners are rounded by parabolas, and the result is averaged over a window in u. At both ends
    the path is mirrored at its end, so that the averaged path starts and ends exactly there.

    Args:
        poses: (k, 4, 4) rigid transforms, k >= 2; the first is the present pose of the tool.
        frame: (4, 4) frame of the poses, which only :meth:`position` uses.

    Attributes:
        given: (k, 6) coordinates of the poses.
        knots: (p + 1,) u [m], from 0; the third derivative is constant between knots.

    Raises:
        InputError: All poses are the same, or one is upside down relative to the first.
    """

    def __init__(self, poses: Array, options: ToolPathOptions, frame: Array | None = None) -> None:
        self._frame: Array = np.eye(4) if frame is None else frame
        self._first: Array = poses[0, :3, :3].copy()
        self.given: Array = coordinates(poses)
        kept, (_, rounded, averaged) = self._kept(options)
        points = self.given[kept]
        room = rounded * options.tolerance, rounded * options.angular_tolerance / math.sqrt(2.0)
        groups = (
            AxisGroup((0, 1, 2), 1.0, MAX_BEND, 1.0, room[0]),
            AxisGroup((3, 4, 5), 1.0 / ROTATION_LENGTH, MAX_BEND / ROTATION_LENGTH, 1.0, room[1]),
        )
        steps = np.diff(points, axis=0)
        spans = max_utilisation(groups, steps, [group.velocity for group in groups])
        self._kept_at = np.concatenate([[0.0], np.cumsum(spans)])
        self._kept_index = kept
        curve = Curve(points, groups, room)
        if curve.end < MIN_LENGTH:
            raise InputError("there is nothing to do: the tool is already there")
        if curve.end > options.max_length:
            raise InputError(
                f"the path is {curve.end:.0f} m long, at most "
                f"{options.max_length:g} m are accepted"
            )
        self.knots, self._values, self._slopes, self._bends = _averaged(
            curve, options, groups, averaged
        )
        self._values[0], self._values[-1] = points[0], points[-1]
        self._jerks: Array = np.diff(self._bends, axis=0) / np.diff(self.knots)[:, None]

    @property
    def end(self) -> float:
        """Parameter u at the end [m]."""
        return float(self.knots[-1])

    def at(self, u: Array) -> Array:
        """Return coordinates (m, 6) at u (m,), held at the ends."""
        return self.derivatives(u, 0)[0]

    def derivatives(self, u: Array, order: int) -> list[Array]:
        """Return coordinates and derivatives up to an order of at most 2, each (m, 6)."""
        u = np.clip(u, 0.0, self.end)
        i = np.searchsorted(self.knots[1:-1], u, side="right")
        s = (u - self.knots[i])[:, None]
        value, slope, bend, jerk = (
            table[i] for table in (self._values, self._slopes, self._bends, self._jerks)
        )
        result = [value + s * (slope + s * (0.5 * bend + s * jerk / 6.0))]
        if order > 0:
            result.append(slope + s * (bend + 0.5 * s * jerk))
        if order > 1:
            result.append(bend + s * jerk)
        return result

    def pose(self, u: Array) -> Array:
        """Return poses (m, 4, 4) of the tool at u (m,)."""
        return self._pose(self.at(u))

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Return poses (m, 4, 4), twist (m, 6) per u and its derivative by u, at u (m,).

        The twist is the linear velocity of the tool's origin and the angular velocity, as in the
        Jacobian.
        """
        c, first, second = self.derivatives(u, 2)
        pose = self._pose(c)
        rotation = upright(c[:, 3])
        swing, rate, bend = c[:, 4:], first[:, 4:], second[:, 4:]
        step = SMALL
        turn, half = step * bend, 0.5 * step * step * bend
        swings = np.concatenate([swing, swing + step * rate + half, swing - step * rate + half])
        spins = swing_rate(swings, np.concatenate([rate, rate + turn, rate - turn]))
        here, ahead, behind = np.split(spins, 3)
        spin = _rotated(rotation, here)
        change = _rotated(rotation, (ahead - behind) / (2.0 * step))
        psi = first[:, 3:4]
        omega = spin.copy()
        omega[:, 2:] += psi
        # psi' z x spin, and psi'' about z.
        change[:, 0] -= psi[:, 0] * spin[:, 1]
        change[:, 1] += psi[:, 0] * spin[:, 0]
        change[:, 2] += second[:, 3]
        return pose, np.hstack([first[:, :3], omega]), np.hstack([second[:, :3], change])

    def length(self) -> float:
        """Return the path length of the tool's origin [m], by Simpson's rule on each piece."""
        spans = np.diff(self.knots)
        middle = self.derivatives(self.knots[:-1] + 0.5 * spans, 1)[1]
        speeds = [np.linalg.norm(part[:, :3], axis=1) for part in (self._slopes, middle)]
        ends, inner = speeds[0][:-1] + speeds[0][1:], speeds[1]
        return float((spans * (ends + 4.0 * inner)).sum() / 6.0)

    def position(self, u: float) -> Array:
        """Return the position (3,) of the tool at u, outside of `frame` [m]."""
        result: Array = (self._frame @ self.pose(np.array([u])))[0, :3, 3]
        return result

    def pose_index(self, u: float) -> int:
        """Return the index of the given pose nearest to u on the same piece of the path."""
        i = int(np.clip(np.searchsorted(self._kept_at, u) - 1, 0, len(self._kept_at) - 2))
        first, last = int(self._kept_index[i]), int(self._kept_index[i + 1])
        difference = self.given[first : last + 1] - self.at(np.array([u]))
        difference[:, 3:] *= ROTATION_LENGTH
        return first + int((difference * difference).sum(axis=1).argmin())

    def _kept(self, options: ToolPathOptions) -> tuple[NDArray[np.intp], ToleranceSplit]:
        scale = np.repeat(
            [options.tolerance / math.sqrt(3.0), options.angular_tolerance / math.sqrt(6.0)], 3
        )
        # The index is carried along as a coordinate with an infinite scale.
        rows = np.column_stack([self.given, np.arange(len(self.given))])
        rows = polyline.remove_repeats(rows, np.append(scale, np.inf))
        if len(rows) < 2:
            raise InputError("there is nothing to do: the tool is already there")
        kept = []
        for fractions in (FINE, COARSE):
            simplified = polyline.simplify(rows, np.append(fractions[0] * scale, np.inf))
            simplified = polyline.remove_repeats(simplified, np.append(scale, np.inf))
            kept.append((simplified[:, 6].astype(np.intp), fractions))
        fine, coarse = kept
        return coarse if 2 <= len(coarse[0]) <= NOISY_FRACTION * len(fine[0]) else fine

    def _pose(self, c: Array) -> Array:
        result = np.zeros((len(c), 4, 4))
        result[:, :3, :3] = upright(c[:, 3]) @ tilted(c[:, 4:]) @ self._first
        result[:, :3, 3] = c[:, :3]
        result[:, 3, 3] = 1.0
        return result


def coordinates(poses: Array) -> Array:
    """Return coordinates (k, 6) of poses (k, 4, 4), with psi unwrapped from 0 on.

    Raises:
        InputError: A pose is upside down relative to the first.
    """
    relative = poses[:, :3, :3] @ poses[0, :3, :3].T
    swing = np.arctan2(np.hypot(relative[:, 0, 2], relative[:, 1, 2]), relative[:, 2, 2])
    if float(swing.max()) > MAX_SWING:
        worst = int(swing.argmax())
        raise InputError(
            f"pose {worst - 1} of the path tilts the tool by {swing[worst]:.3g} rad from its "
            f"present orientation, at most {MAX_SWING:g} rad are allowed"
        )
    # The upper left block is Rz(psi) times a symmetric block with a positive trace.
    psi = np.arctan2(relative[:, 1, 0] - relative[:, 0, 1], relative[:, 0, 0] + relative[:, 1, 1])
    psi = np.unwrap(psi)
    tilt = np.swapaxes(upright(psi), 1, 2) @ relative
    # The tilt's axis is horizontal, its third column is (sin n_y, -sin n_x, cos).
    ratio = np.where(swing > SMALL, swing / np.maximum(np.sin(swing), 1e-12), 1.0)
    return np.column_stack([poses[:, :3, 3], psi, -tilt[:, 1, 2] * ratio, tilt[:, 0, 2] * ratio])


def upright(angle: Array) -> Array:
    """Return rotations (k, 3, 3) by angles (k,) about z."""
    result = np.zeros((len(angle), 3, 3))
    result[:, 0, 0] = result[:, 1, 1] = np.cos(angle)
    result[:, 1, 0] = np.sin(angle)
    result[:, 0, 1] = -result[:, 1, 0]
    result[:, 2, 2] = 1.0
    return result


def _parts(square: Array) -> tuple[Array, Array]:
    """Return sin a / a and (1 - cos a) / a^2 for squared angles a^2."""
    angle = np.sqrt(square)
    half = np.sinc(angle / math.tau)
    return np.sinc(angle / math.pi), 0.5 * half * half


def tilted(swing: Array) -> Array:
    """Return rotations (k, 3, 3) by horizontal rotation vectors (k, 2), after Rodrigues."""
    x, y = swing.T
    sine, versine = _parts(x * x + y * y)
    result = np.empty((len(swing), 3, 3))
    result[:, 0, 0] = 1.0 - versine * y * y
    result[:, 0, 1] = result[:, 1, 0] = versine * x * y
    result[:, 0, 2] = sine * y
    result[:, 2, 0] = -result[:, 0, 2]
    result[:, 1, 1] = 1.0 - versine * x * x
    result[:, 1, 2] = -sine * x
    result[:, 2, 1] = -result[:, 1, 2]
    result[:, 2, 2] = 1.0 - versine * (x * x + y * y)
    return result


def swing_rate(swing: Array, rate: Array) -> Array:
    """Return the spatial angular velocity (k, 3) of exp(swing) for swing and its rate, (k, 2)."""
    x, y = swing.T
    sine, versine = _parts(x * x + y * y)
    square = np.maximum(x * x + y * y, 1e-300)
    factor = np.where(square > SMALL, (1.0 - sine) / square, 1.0 / 6.0)
    along = factor * (x * rate[:, 0] + y * rate[:, 1])
    return np.column_stack(
        [
            sine * rate[:, 0] + along * x,
            sine * rate[:, 1] + along * y,
            versine * (x * rate[:, 1] - y * rate[:, 0]),
        ]
    )


def _rotated(rotation: Array, vectors: Array) -> Array:
    result: Array = (rotation @ vectors[:, :, None])[:, :, 0]
    return result


def _averaged(
    curve: Curve, options: ToolPathOptions, groups: tuple[AxisGroup, AxisGroup], fraction: float
) -> tuple[Array, Array, Array, Array]:
    """Return knots (p + 1,), values, slopes, bends (p + 1, 6) of a curve's average over a window.

    They are computed from q'' with the kernels K(s) = (w/2 - |s|)^2 / (2 w) for q, -K' for q',
    1/w for q''.
    """
    window = min(MAX_WINDOW, 0.25 * curve.end)
    for group, tolerance in zip(
        groups, (options.tolerance, options.angular_tolerance / math.sqrt(2.0)), strict=True
    ):
        bend = float(group.norm(curve.bends).max())
        window = min(window, math.sqrt(24.0 * fraction * tolerance / max(bend, 1e-9)))
    half = 0.5 * window
    knots, bends = curve.knots, curve.bends
    head = int(np.searchsorted(knots, half, side="right"))
    tail = int(np.searchsorted(knots, curve.end - half))
    edges = np.concatenate([-knots[head:0:-1], knots, 2.0 * curve.end - knots[tail:-1][::-1]])
    pieces = np.vstack([-bends[:head][::-1], bends, -bends[tail:][::-1]])
    inner = np.unique(np.concatenate([edges - half, edges + half]))
    spacing = 1e-3 * window
    inner = inner[(inner > spacing) & (inner < curve.end - spacing)]
    at = np.concatenate([[0.0], inner, [curve.end]])
    at = at[np.concatenate([[True], np.diff(at) > 1e-12])]
    at[-1] = curve.end
    value, slope = curve.at(at), curve.slope(at)
    bend_average: Array = np.zeros((len(at), 6))
    first = np.maximum(np.searchsorted(edges, at - half, side="right") - 1, 0)
    last = np.minimum(np.searchsorted(edges, at + half, side="left"), len(pieces))
    for offset in range(int((last - first).max())):
        i = first + offset
        inside = i < last
        i = np.minimum(i, len(pieces) - 1)
        low = np.clip(edges[i] - at, -half, half)
        high = np.clip(edges[i + 1] - at, -half, half)
        part = np.where(inside[:, None], pieces[i], 0.0)
        weight = (_kernel_integral(high, half) - _kernel_integral(low, half)) / (2.0 * window)
        value += part * weight[:, None]
        slope_weight = ((half - np.abs(high)) ** 2 - (half - np.abs(low)) ** 2) / (2.0 * window)
        slope -= part * slope_weight[:, None]
        bend_average += part * ((high - low) / window)[:, None]
    return at, value, slope, bend_average


def _kernel_integral(s: Array, half: float) -> Array:
    """Return the antiderivative of (half - |s|)^2 that is 0 at 0."""
    result: Array = np.sign(s) * (half**3 - (half - np.abs(s)) ** 3) / 3.0
    return result
