"""A step of the planning model, and its derivatives by the chain rule.

Currents act through the acceleration that they add to that of the free robot: all derivatives of a
step are by the body twist and that acceleration, six columns for any number of wheels.
"""

from typing import NamedTuple

import casadi as ca

from omniman_ros.planning.mpc.model import PlanningModel


class Sensitive(NamedTuple):
    """A vector and its derivatives.

    In a `ModelStep` they are (3,) and (3, 6), by twist and added acceleration at its start.
    """

    value: ca.SX
    slope: ca.SX

    def plus(self, factor: float, other: "Sensitive") -> "Sensitive":
        """Return this vector plus a multiple of another one."""
        return Sensitive(
            self.value + factor * other.value, ca.densify(self.slope + factor * other.slope)
        )

    def turned(self, duration: float, spin: "Sensitive") -> "Sensitive":
        """Return this twist of a frame that has turned by `duration` times a yaw rate.

        It is expressed in the frame before.
        """
        angle = duration * spin.value[2]
        turn = rotation(angle)
        value = turn @ self.value
        across = ca.vertcat(-value[1], value[0], 0)
        return Sensitive(value, turn @ self.slope + duration * across @ spin.slope[2, :])


class ModelStep(NamedTuple):
    """What a step leads to; currents are constant over it."""

    start: Sensitive  #: Twist at the start [m/s, m/s, rad/s]
    rate: Sensitive  #: Derivative of the twist at the start [m/s^2, m/s^2, rad/s^2]
    displacement: Sensitive  #: Change of the pose in base_link at the start [m, m, rad]
    middle: Sensitive  #: Twist at the middle
    end: Sensitive  #: Twist at the end


def model_step(model: PlanningModel, twist: ca.SX, added: ca.SX, duration: float) -> ModelStep:
    """Return a step by Runge-Kutta 4 from a twist (3,).

    Args:
        added: (3,) acceleration by the currents, `PlanningModel.drive` times them.
        duration: Duration of the step h [s].
    """
    h, free = duration, model.free_rate
    start = Sensitive(twist, ca.horzcat(ca.SX.eye(3), ca.SX(3, 3)))
    by_added = ca.horzcat(ca.SX(3, 3), ca.SX.eye(3))

    def rate(v: Sensitive) -> Sensitive:
        value, slope = free(v.value)
        return Sensitive(value + added, slope @ v.slope + by_added)

    def mean(a: Sensitive, b: Sensitive, c: Sensitive, d: Sensitive) -> Sensitive:
        """Return the weighted mean of Runge-Kutta's four stages."""
        return Sensitive(
            (a.value + 2 * b.value + 2 * c.value + d.value) / 6.0,
            (a.slope + 2 * b.slope + 2 * c.slope + d.slope) / 6.0,
        )

    k1 = rate(start)
    v2 = start.plus(0.5 * h, k1)
    k2 = rate(v2)
    v3 = start.plus(0.5 * h, k2)
    k3 = rate(v3)
    v4 = start.plus(h, k3)
    end = start.plus(h, mean(k1, k2, k3, rate(v4)))
    # Stages of the pose in the frame of the pose at the start.
    turned = v2.turned(0.5 * h, start), v3.turned(0.5 * h, v2), v4.turned(h, v3)
    moved = mean(start, *turned)
    middle = Sensitive(0.5 * (v2.value + v3.value), 0.5 * (v2.slope + v3.slope))
    return ModelStep(start, k1, Sensitive(h * moved.value, h * moved.slope), middle, end)


def rotation(angle: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) from twists of a frame at an angle to those of the frame itself."""
    c, s = ca.cos(angle), ca.sin(angle)
    turn = ca.SX.eye(3)
    turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1] = c, -s, s, c
    return turn


def rotated(angle: ca.SX, vector: ca.SX) -> ca.SX:
    """Return a vector (2,), given in a frame rotated by an angle, in the unrotated frame."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1])
