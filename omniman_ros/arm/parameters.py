"""Everything that streaming to a UR controller is set by, declared once."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter

PERIOD = 0.008
"""Cycle of a CB3 controller, CCTA 2017 V.A [s]."""


@dataclass(frozen=True, kw_only=True)
class UrParameters:
    """Where the controller is, how its program servos, and when it is lost."""

    host: str = parameter(
        "127.0.0.1", "Address of the controller; this machine's is where simulated_ur listens.",
        read_only=True,
    )  # fmt: skip
    rtde_port: int = parameter(
        30004, "Its port for real-time data (RTDE).", low=1, high=65535, read_only=True
    )
    script_port: int = parameter(
        30002, "Its port that takes programs.", low=1, high=65535, read_only=True
    )
    dashboard_port: int = parameter(
        29999, "Its port of the dashboard server.", low=1, high=65535, read_only=True
    )
    reverse_host: str = parameter(
        "", "Address of this machine as the controller sees it; empty: that of the connection "
        "to it.", read_only=True,
    )  # fmt: skip
    reverse_port: int = parameter(
        50001, "Port here that the program calls; 0: any that is free.", low=0, high=65535,
        read_only=True,
    )  # fmt: skip
    register: int = parameter(
        24, "Output integer register in which the program counts the setpoints it has read.",
        low=0, high=47, read_only=True,
    )  # fmt: skip
    lookahead_time: float = parameter(
        0.03, "servoj: smooths the motion by looking ahead; the arm follows later by it.",
        unit="s", low=0.03, high=0.2, read_only=True,
    )  # fmt: skip
    gain: float = parameter(
        300.0, "servoj: proportional gain.", low=100, high=2000, read_only=True
    )
    servo_lag: float = parameter(
        0.042, "By how much the arm is behind its setpoints (lookahead, joints, transport): they "
        "are sent so much ahead, so that it is in time. To find it: add the time by which "
        "arm/joint_states are behind arm/joint_reference in steady motion (the demo tells that of "
        "its arm: behind by).",
        unit="s", low=0, high=0.3, read_only=True,
    )  # fmt: skip
    read_timeout: float = parameter(
        0.04, "Time without a setpoint after which the program stops the arm.", unit="s",
        low=0.016, high=0.2, read_only=True,
    )  # fmt: skip
    feedback_timeout: float = parameter(
        0.08, "Age of the last data, or of the last setpoint that the program read, at which the "
        "controller is lost.", unit="s", low=0.024, high=1,
    )  # fmt: skip
    connect_timeout: float = parameter(
        2.0, "How long a connection, a program's call or an answer may take.", unit="s", low=0.05,
        high=30,
    )  # fmt: skip
    following_error: float = parameter(
        0.2, "Largest distance of a setpoint from the measured angle.", unit="rad", low=0.005,
        high=3,
    )  # fmt: skip
    start_distance: float = parameter(
        0.05, "How far from the arm a preview may begin; the arm is led onto it.", unit="rad",
        low=0.0001, high=0.5,
    )  # fmt: skip
    priority: int = parameter(
        50, "Priority (SCHED_FIFO) of the streaming process, where it is permitted; 0: none.",
        low=0, high=99, read_only=True,
    )  # fmt: skip
    unlock: bool = parameter(
        False, "Whether ~/reset asks the controller to unlock a protective stop; else that is "
        "done on its pendant, after a look at the arm.",
    )  # fmt: skip
