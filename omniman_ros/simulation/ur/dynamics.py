"""The controller's own model of its arm: the torques that a motion takes, and the currents."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.description.inertia import Inertia
from omniman_ros.description.transforms import transform
from omniman_ros.description.ur5 import ROTOR_INERTIAS, links, tool_inertia
from omniman_ros.simulation.ur.kinematics import GRAVITY

#: Torque at each joint per motor current [N m/A]; similar to a UR5's
TORQUE_CONSTANTS = np.array([12.5, 12.5, 12.5, 9.2, 9.2, 9.2])
#: Viscous friction of each motor with its gear [N m s/rad]; similar to a UR5's
FRICTION = np.array([8.0, 8.0, 5.0, 2.0, 2.0, 2.0])
AXIS = np.array([0.0, 0.0, 1.0])  #: Axis of each joint in the frame of its link


class ArmDynamics:
    """Torques of an arm on a base at rest, by the recursive Newton-Euler algorithm.

    Masses and centres of mass are those of the manufacturer, as in the robot's description. Each
    rotor has an inertia along the axis of its joint alone.
    Source of the algorithm: J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "On-Line Computational
    Scheme for Mechanical Manipulators" (1980).

    Args:
        payload: Mass of tool and load that the controller reckons with [kg].
    """

    def __init__(self, payload: float) -> None:
        arm = links()
        self._turns = [transform(link.place, link.rpy)[:3, :3] for link in arm]
        self._places = [np.array(link.place) for link in arm]
        inertias = [link.inertia for link in arm]
        bodies = [(i.mass, np.array(i.centre), _tensor(i)) for i in inertias]
        bodies[-1] = _joined(bodies[-1], tool_inertia(payload))
        self._bodies = bodies

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the torques (6,) [N m] of angles [rad] and their derivatives, no friction.

        Args:
            qd: Speeds (6,) [rad/s].
            qdd: Accelerations (6,) [rad/s^2].
        """
        turns, forces, moments = [], [], []
        rate, rate_change = np.zeros(3), np.zeros(3)
        acceleration = np.array([0.0, 0.0, GRAVITY])
        motion = zip(q.tolist(), qd.tolist(), qdd.tolist(), strict=True)
        for k, (angle, speed, change) in enumerate(motion):
            c, s = math.cos(angle), math.sin(angle)
            turn = self._turns[k] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            back = turn.T
            motion_of_frame = _skew(rate_change) + _skew(rate) @ _skew(rate)
            acceleration = back @ (acceleration + motion_of_frame @ self._places[k])
            rate = back @ rate
            rate_change = back @ rate_change + change * AXIS + speed * (_skew(rate) @ AXIS)
            rate = rate + speed * AXIS
            mass, centre, tensor = self._bodies[k]
            spin = _skew(rate)
            force = mass * (acceleration + (_skew(rate_change) + spin @ spin) @ centre)
            turns.append(turn)
            forces.append(force)
            moments.append(tensor @ rate_change + spin @ (tensor @ rate) + _skew(centre) @ force)
        torques = np.array(ROTOR_INERTIAS) * qdd
        force, moment = np.zeros(3), np.zeros(3)
        for k in reversed(range(len(turns))):
            force, moment = force + forces[k], moment + moments[k]
            torques[k] += moment[2]
            force = turns[k] @ force
            moment = turns[k] @ moment + _skew(self._places[k]) @ force
        return torques


def motor_torque(joint_torque: Array, qd: Array) -> Array:
    """Return what the motors give for torques of the joints (6,) [N m]: these, and friction.

    Args:
        qd: Speeds of the joints (6,) [rad/s].
    """
    return joint_torque + FRICTION * qd


def _skew(v: Array) -> Array:
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _tensor(inertia: Inertia) -> Array:
    """Return the tensor of inertia about the centre of mass, in the link's axes (3, 3)."""
    turn = transform(inertia.centre, inertia.rpy)[:3, :3]
    tensor: Array = turn @ np.diag(inertia.moments) @ turn.T
    return tensor


def _joined(body: tuple[float, Array, Array], load: Inertia) -> tuple[float, Array, Array]:
    """Return mass, centre of mass and tensor of a link together with a load on it."""
    parts = (body, (load.mass, np.array(load.centre), _tensor(load)))
    mass = sum(part[0] for part in parts)
    centre = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part_mass, place, own in parts:
        offset = _skew(place - centre)
        tensor += own - part_mass * offset @ offset
    return mass, centre, tensor
