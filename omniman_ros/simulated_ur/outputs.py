"""Values of the RTDE outputs, each from the state of the controller."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.simulated_ur import kinematics
from omniman_ros.simulated_ur.arm import TORQUE_CONSTANTS, Arm
from omniman_ros.simulated_ur.modes import MOVING, Modes, Runtime
from omniman_ros.simulated_ur.motion import Target
from omniman_ros.simulated_ur.registers import Registers
from omniman_ros.simulated_ur.rtde_types import OUTPUTS, Value, size

Array = NDArray[np.float64]

VOLTAGE, TEMPERATURE, TOOL_MODE = 48.0, 30.0, 253
"""Of joints and tool [V, deg C]; they do not change."""


class State(Protocol):
    """What of the controller is told; see `Controller`."""

    arm: Arm
    target: Target
    target_qdd: Array
    modes: Modes
    runtime: Runtime
    registers: Registers
    fraction: float
    limiter: float

    @property
    def target_qd(self) -> Array:
        """Speed of the target [rad/s]."""
        ...

    @property
    def timestamp(self) -> float:
        """Time since the start [s]."""
        ...


def _vector(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())


def _six(value: float) -> tuple[float, ...]:
    return (value,) * 6


def status_bits(c: State) -> int:
    """robot_status_bits: 0 power on, 1 program running."""
    return c.modes.powered << 0 | (c.runtime in MOVING) << 1


def currents(c: State) -> Array:
    """Of the motors [A]; none without power."""
    return c.arm.currents(c.arm.q, c.arm.qd, c.arm.qdd) * c.modes.powered


def target_currents(c: State) -> Array:
    """That the trajectory should need [A]."""
    return c.arm.currents(c.target.q, c.target_qd, c.target_qdd) * c.modes.powered


def _elbow(c: State) -> Array:
    return kinematics.frames(c.arm.q)[kinematics.ELBOW][:3, 3]


_READ: dict[str, Callable[[State], Value]] = {
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
    # Of the speed slider's fraction, as the public ROS driver reads it: the product is the pace.
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
}
"""Those that change, or are not zero; forces, analog and digital inputs are."""


def value(controller: State, name: str) -> Value:
    """Value of an RTDE output now.

    Args:
        controller: Whose.
        name: One of `rtde_types.OUTPUTS`.
    """
    read = _READ.get(name)
    if read is not None:
        return read(controller)
    register = controller.registers.values.get(name)
    if register is not None:
        return register
    count = size(OUTPUTS[name])
    return (0.0,) * count if count else 0
