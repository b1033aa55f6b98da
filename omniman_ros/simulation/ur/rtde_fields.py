"""RTDE fields of the simulated controller, and their types.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide", "Data types", "Robot controller
inputs" and "Robot controller outputs"; numbers are big-endian.
"""

import struct
from collections.abc import Iterable, Sequence

Number = int | float | bool  #: Value of a scalar field, or one element of a vector
Value = Number | Sequence[Number]  #: Value of a field: a number, or the numbers of a vector

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}  #: Format of each type, as `struct` writes it
REGISTERS = 48  #: Number of integer and of double registers; clients use those from 24 on
BOOLS = range(64, 128)  #: Bits that are transferred one by one; lower ones are in groups of 32


def _registers(side: str) -> dict[str, str]:
    fields = {f"{side}_bit_registers{first}_to_{first + 31}": "UINT32" for first in (0, 32)}
    fields |= {f"{side}_bit_register_{k}": "BOOL" for k in BOOLS}
    fields |= {f"{side}_int_register_{k}": "INT32" for k in range(REGISTERS)}
    return fields | {f"{side}_double_register_{k}": "DOUBLE" for k in range(REGISTERS)}


def _all(kind: str, names: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), kind)


INPUTS = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    **_all(
        "UINT8",
        "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
        "configurable_digital_output tool_digital_output_mask tool_digital_output "
        "standard_analog_output_mask standard_analog_output_type",
    ),
    **_all("DOUBLE", "standard_analog_output_0 standard_analog_output_1"),
    "external_force_torque": "VECTOR6D",
    **_registers("input"),
}  #: Fields that a client writes

OUTPUTS = {
    "timestamp": "DOUBLE",
    **_all(
        "VECTOR6D",
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd "
        "actual_current joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force "
        "target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage payload_inertia",
    ),
    "joint_mode": "VECTOR6INT32",
    **_all("VECTOR3D", "actual_tool_accelerometer elbow_position elbow_velocity payload_cog"),
    **_all("INT32", "robot_mode safety_mode safety_status tool_output_voltage"),
    **_all("UINT64", "actual_digital_input_bits actual_digital_output_bits"),
    **_all(
        "UINT32",
        "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode "
        "tool_analog_input_types",
    ),
    **_all(
        "DOUBLE",
        "actual_execution_time speed_scaling target_speed_fraction actual_momentum "
        "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 "
        "standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
        "tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature "
        "tcp_force_scalar payload",
    ),
    **_registers("output"),
    **_registers("input"),
}  #: Fields that a client reads


def codec(kinds: Iterable[str]) -> struct.Struct:
    """Return the binary layout of values of these types."""
    return struct.Struct(">" + "".join(FORMATS[kind] for kind in kinds))


def flatten(values: Iterable[Value]) -> list[Number]:
    """Return all numbers in one list, including those of vectors."""
    flat: list[Number] = []
    for value in values:
        if isinstance(value, (int, float)):
            flat.append(value)
        else:
            flat.extend(value)
    return flat


def size(kind: str) -> int:
    """Return the length of a vector type; 0 for a type that is not a vector."""
    return int(FORMATS[kind][:-1] or 0)


def regroup(flat: Sequence[Number], kinds: Iterable[str]) -> list[Value]:
    """Return the values of a flat list: the inverse of :func:`flatten`."""
    values: list[Value] = []
    start = 0
    for kind in kinds:
        count = size(kind)
        values.append(tuple(flat[start : start + count]) if count else flat[start])
        start += count or 1
    return values
