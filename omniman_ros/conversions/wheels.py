"""Convert commands to the wheels, their electrical state and their reported health."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, UInt32MultiArray

from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.control.wheel_health import IDLE
from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: Key in `wheel_health` of the fraction of the limits that remains if a wheel is dead
LIMIT_SCALE_KEY = "limits"
#: Key in `wheel_health` of the fraction of the limits that the arm's configuration allows
POSTURE_SCALE_KEY = "posture_limits"


@dataclass(frozen=True)
class LimitScales:
    """Fractions of the limits that `wheel_health` reports as left, above 0 and up to 1."""

    wheels: float = 1.0  #: Fraction that dead wheels leave; grows when the controller is reset
    posture: float = 1.0  #: Fraction that the arm's configuration allows

    @property
    def total(self) -> float:
        """Fraction of velocity and acceleration that both leave."""
        return self.wheels * self.posture


def reported_limit_scales(message: DiagnosticStatus) -> LimitScales:
    """Return the fractions of the limits that `wheel_health` reports as left; 1 if it does not.

    Raises:
        InputError: A value is not a number above 0 and up to 1.
    """
    values = {item.key: item.value for item in message.values}
    wheels, posture = (
        _scale(key, values.get(key, "1")) for key in (LIMIT_SCALE_KEY, POSTURE_SCALE_KEY)
    )
    return LimitScales(wheels, posture)


def _scale(key: str, text: str) -> float:
    """Return a fraction of the limits above 0 and up to 1 [-]; raises an InputError."""
    try:
        scale = float(text)
    except ValueError:
        scale = math.nan
    if not 0.0 < scale <= 1.0:
        raise InputError(f"{key} '{text[:40]}' must be above 0 and up to 1")
    return scale


def reported_idle_wheels(message: DiagnosticStatus, names: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the wheels that `wheel_health` reports as idle; others drive."""
    state = {item.key: item.value for item in message.values}
    return tuple(i for i, name in enumerate(names) if state.get(name) == IDLE)


def wheel_command_from_message(
    message: JointState, names: Sequence[str], voltage: bool
) -> WheelCommand:
    """Return the command in a message from `wheel_voltages` or `wheel_commands`.

    Args:
        message: Command with efforts [V or N m], velocities [rad/s], or both.

    Raises:
        InputError: Names, sizes or content are wrong, or velocity and effort are both missing.
    """
    _, velocity, effort = joint_arrays(message, names)
    if voltage:
        volts = require_array(effort, plausible.EFFORT, "effort (volts)")
        return WheelCommand(DriveMode.VOLTAGE, volts)
    if velocity is None:
        torque = require_array(effort, plausible.EFFORT, "velocity or effort")
        return WheelCommand(DriveMode.TORQUE, torque)
    speeds = require_array(velocity, plausible.WHEEL_SPEED, "velocity")
    if effort is None:
        return WheelCommand(DriveMode.VELOCITY, np.zeros(len(names)), speeds)
    torque = require_array(effort, plausible.EFFORT, "effort")
    return WheelCommand(DriveMode.VELOCITY, torque, speeds)


class WheelValues(Protocol):
    """Measurements of n wheels, whoever made them."""

    @property
    def position(self) -> Array:
        """Angles (n,) [rad]."""

    @property
    def velocity(self) -> Array:
        """Speeds (n,) [rad/s]."""

    @property
    def effort(self) -> Array:
        """Torques (n,) [N m]."""


def states_message(names: list[str], states: WheelValues, stamp: Time) -> JointState:
    """Return the message for the states of n wheels."""
    message = JointState(
        name=names,
        position=states.position.tolist(),
        velocity=states.velocity.tolist(),
        effort=states.effort.tolist(),
    )
    message.header.stamp = stamp
    return message


def electrical_message(values: Array) -> Float64MultiArray:
    """Return the message for the voltage [V], current [A] and energy [J] (n, 3) of n wheels."""
    rows, columns = values.shape
    message = Float64MultiArray(data=values.ravel().tolist())
    message.layout.dim = [
        MultiArrayDimension(label="wheel", size=rows, stride=rows * columns),
        MultiArrayDimension(label="voltage,current,energy", size=columns, stride=columns),
    ]
    return message


def restarts_message(restarts: Sequence[int]) -> UInt32MultiArray:
    """Return the message for the numbers of restarts of n drives."""
    message = UInt32MultiArray(data=[count % 2**32 for count in restarts])
    message.layout.dim = [MultiArrayDimension(label="wheel", size=len(restarts), stride=1)]
    return message


def restarts_of_message(message: UInt32MultiArray, n: int) -> tuple[int, ...]:
    """Return the numbers of restarts of n drives; raise InputError if there are others."""
    sizes = [dimension.size for dimension in message.layout.dim]
    if len(message.data) != n or sizes not in ([], [n]):
        raise InputError(f"wheel_restarts: {len(message.data)} values, sizes {sizes}, {n} wheels")
    return tuple(message.data)


def electrical_rows(message: Float64MultiArray, n: int) -> Array:
    """Return voltage [V], current [A] and energy [J] (n, 3) of n wheels, in the message's order.

    Raises:
        InputError: The sizes or columns are not voltage, current and energy of n wheels, or are
            not those of the data.
    """
    labels = [dimension.label for dimension in message.layout.dim]
    if labels[1:] != ["voltage,current,energy"]:
        raise InputError(
            f"wheel_electrical: columns {labels[1:]}, expected 'voltage,current,energy'"
        )
    if len(message.data) != 3 * n:
        raise InputError(f"wheel_electrical: {len(message.data)} numbers, expected {3 * n}")
    sizes = [dimension.size for dimension in message.layout.dim]
    if sizes != [n, 3] or message.layout.data_offset:
        offset = message.layout.data_offset
        raise InputError(
            f"wheel_electrical: sizes {sizes} from number {offset} on, expected [{n}, 3] from 0"
        )
    return np.array(message.data, dtype=float).reshape(n, 3)


def electrical_arrays(message: Float64MultiArray, n: int) -> tuple[Array, Array]:
    """Return voltages and currents (n,) [V, A] of n wheels; see :func:`electrical_rows`."""
    rows = electrical_rows(message, n)
    return rows[:, 0], rows[:, 1]
