"""Parameters of the streaming to a UR controller."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

PERIOD = 0.008  #: Cycle time of a CB3 controller, CCTA 2017 V.A [s]


@dataclass(frozen=True, kw_only=True)
class UrParameters(Validated):
    """Address of the controller, servo parameters of its program, and timeouts."""

    host: str = parameter(
        "127.0.0.1",
        "Address of the controller; the default is that of simulated_ur on this machine.",
        read_only=True,
    )
    rtde_port: int = parameter(
        30004,
        "Port of the controller for real-time data (RTDE).",
        low=1,
        high=65535,
        read_only=True,
    )
    script_port: int = parameter(
        30002, "Port of the controller that accepts programs.", low=1, high=65535, read_only=True
    )
    dashboard_port: int = parameter(
        29999, "Port of the controller's dashboard server.", low=1, high=65535, read_only=True
    )
    reverse_host: str = parameter(
        "",
        "Address of this machine as seen by the controller; if empty, the local address of the "
        "connection to it.",
        read_only=True,
    )
    reverse_port: int = parameter(
        50001,
        "Local port to which the program connects; 0 selects any free one.",
        low=0,
        high=65535,
        read_only=True,
    )
    register: int = parameter(
        24,
        "Output integer register in which the program counts the setpoints it has read.",
        low=0,
        high=47,
        read_only=True,
    )
    lookahead_time: float = parameter(
        0.03,
        "servoj: smooths the motion by looking ahead, and delays the arm by as much.",
        unit="s",
        low=0.03,
        high=0.2,
        read_only=True,
    )
    gain: float = parameter(
        2000.0,
        "servoj: proportional gain. A lower one lets the arm deviate where it accelerates.",
        low=100,
        high=2000,
        read_only=True,
    )
    servo_lag: float = parameter(
        0.042,
        "Delay of the arm behind its setpoints (lookahead, joints, transport). Setpoints are sent "
        "ahead by it, so that the arm is on time. To find it, add the time by which "
        "arm/joint_states lags behind arm/joint_reference in steady motion (the demo reports it "
        "as the lag of the arm).",
        unit="s",
        low=0,
        high=0.3,
        read_only=True,
    )
    read_timeout: float = parameter(
        0.04,
        "Time without a setpoint after which the program stops the arm.",
        unit="s",
        low=0.016,
        high=0.2,
        read_only=True,
    )
    feedback_timeout: float = parameter(
        0.08,
        "Age of the newest data, or of the newest setpoint that the program has read, above "
        "which the controller counts as lost.",
        unit="s",
        low=0.024,
        high=1,
    )
    connect_timeout: float = parameter(
        2.0,
        "How long connecting, the program's connection to this host, or an answer may take.",
        unit="s",
        low=0.05,
        high=30,
    )
    following_error: float = parameter(
        0.2,
        "Largest distance between a setpoint and the measured angle.",
        unit="rad",
        low=0.005,
        high=3,
    )
    start_distance: float = parameter(
        0.05,
        "Largest distance from the arm at which a preview may begin; the arm joins it smoothly.",
        unit="rad",
        low=0.0001,
        high=0.5,
    )
    priority: int = parameter(
        50,
        "Priority (SCHED_FIFO) of the streaming process, where it is permitted; 0 requests none.",
        low=0,
        high=99,
        read_only=True,
    )
    unlock: bool = parameter(
        False,
        "Whether ~/reset asks the controller to unlock a protective stop; otherwise a person "
        "unlocks it on the pendant after inspecting the arm.",
    )
