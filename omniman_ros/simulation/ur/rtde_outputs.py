"""Values of the RTDE outputs, derived from the state of the controller."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur import kinematics
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.dynamics import TORQUE_CONSTANTS, motor_torque
from omniman_ros.simulation.ur.modes import MOVING, Cb3RuntimeState, Modes
from omniman_ros.simulation.ur.motion import Target
from omniman_ros.simulation.ur.registers import Registers
from omniman_ros.simulation.ur.rtde_fields import OUTPUTS, Value, size

VOLTAGE = 48.0  #: Voltage of joints and robot [V]
TEMPERATURE = 30.0  #: Temperature of joints and tool [deg C]
TOOL_MODE = 253  #: tool_mode of a tool that runs


class ControllerState(Protocol):
    """State of the controller that the outputs report; see `Controller`."""

    arm: ArmBody
    target: Target
    target_qdd: Array
    modes: Modes
    runtime: Cb3RuntimeState
    registers: Registers
    fraction: float
    limiter: float

    @property
    def target_qd(self) -> Array:
        """Speed of the target [rad/s]."""

    @property
    def timestamp(self) -> float:
        """Time since the start [s]."""


def _vector(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())


def _six(value: float) -> tuple[float, ...]:
    return (value,) * 6


def status_bits(c: ControllerState) -> int:
    """Return robot_status_bits: bit 0 power on, bit 1 program running."""
    return c.modes.powered << 0 | (c.runtime in MOVING) << 1


def currents(c: ControllerState) -> Array:
    """Return the motor currents (6,) [A]; zero without power."""
    torque = motor_torque(c.arm.torque, c.arm.qd)
    return np.asarray(torque / TORQUE_CONSTANTS * c.modes.powered)


def target_currents(c: ControllerState) -> Array:
    """Return the motor currents (6,) that the target motion requires [A]; zero without power."""
    joint_torque = c.arm.dynamics.torque(c.target.q, c.target_qd, c.target_qdd)
    torque = motor_torque(joint_torque, c.target_qd)
    return np.asarray(torque / TORQUE_CONSTANTS * c.modes.powered)


def _elbow(c: ControllerState) -> Array:
    return kinematics.frames(c.arm.q)[kinematics.ELBOW][:3, 3]


_READ: dict[str, Callable[[ControllerState], Value]] = {
    "timestamp": lambda c: c.timestamp,
    "target_q": lambda c: _vector(c.target.q),
    "target_qd": lambda c: _vector(c.target_qd),
    "target_qdd": lambda c: _vector(c.target_qdd),
    "target_current": lambda c: _vector(target_currents(c)),
    "target_moment": lambda c: _vector(target_currents(c) * TORQUE_CONSTANTS),
    "actual_q": lambda c: _vector(c.arm.q),
    "actual_qd": lambda c: _vector(c.arm.qd),
    "actual_current": lambda c: _vector(currents(c)),
    "joint_control_output": lambda c: _vector(currents(c)),
    "actual_TCP_pose": lambda c: _vector(kinematics.pose(c.arm.q)),
    "actual_TCP_speed": lambda c: _vector(kinematics.twist(c.arm.q, c.arm.qd)),
    "target_TCP_pose": lambda c: _vector(kinematics.pose(c.target.q)),
    "target_TCP_speed": lambda c: _vector(kinematics.twist(c.target.q, c.target_qd)),
    "elbow_position": lambda c: _vector(_elbow(c)),
    "elbow_velocity": lambda c: _vector(kinematics.twist(c.arm.q, c.arm.qd, kinematics.ELBOW)[:3]),
    "robot_mode": lambda c: int(c.modes.robot),
    "joint_mode": lambda c: (c.modes.joint_mode,) * 6,
    "safety_mode": lambda c: int(c.modes.safety),
    "safety_status": lambda c: int(c.modes.safety),
    "runtime_state": lambda c: int(c.runtime),
    "robot_status_bits": status_bits,
    "safety_status_bits": lambda c: c.modes.safety_bits,
    # This is relative to the slider, as the public ROS driver reads it: the product is the pace.
    "speed_scaling": lambda c: c.limiter,
    "target_speed_fraction": lambda c: c.fraction,
    "actual_digital_output_bits": lambda c: c.registers.digital_outputs,
    "actual_robot_current": lambda c: float(np.sum(np.abs(currents(c)))),
    "actual_joint_voltage": lambda c: _six(VOLTAGE * c.modes.powered),
    "actual_robot_voltage": lambda c: VOLTAGE * c.modes.powered,
    "actual_main_voltage": lambda c: VOLTAGE,
    "joint_temperatures": lambda c: _six(TEMPERATURE),
    "tool_temperature": lambda c: TEMPERATURE,
    "tool_mode": lambda c: TOOL_MODE,
    # The arm stands on the floor, and nothing touches it.
    "actual_tool_accelerometer": lambda c: _vector(
        kinematics.frames(c.arm.q)[-1][2, :3] * kinematics.GRAVITY
    ),
}  #: Functions of the outputs that are not constantly zero, unlike forces and analog inputs


def value(controller: ControllerState, name: str) -> Value:
    """Return the present value of an RTDE output, a key of `rtde_fields.OUTPUTS`."""
    read = _READ.get(name)
    if read is not None:
        return read(controller)
    register = controller.registers.values.get(name)
    if register is not None:
        return register
    count = size(OUTPUTS[name])
    return (0.0,) * count if count else 0
