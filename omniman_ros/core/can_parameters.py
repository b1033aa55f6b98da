"""An installation of drives on a CAN bus: what is connected, how it counts, when it is lost."""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.robot import Robot

Floats = tuple[float, ...]

NODE_IDS = {"cia402": (1, 126), "vesc": (0, 254), "odrive": (0, 63)}
"""Possible ids of a drive; 127 is the host's in CANopen, 255 is all VESCs."""
HEADROOM = 1.2
"""Largest wheel speed that is taken, over the robot's, where the installation names none."""


@dataclass(frozen=True, kw_only=True)
class CanParameters:
    """One installation; what is read-only is fixed once the node runs."""

    interface: str = parameter(
        "socketcan", "Interface of python-can: socketcan, udp_multicast, virtual, slcan, pcan ...",
        read_only=True,
    )  # fmt: skip
    channel: str = parameter(
        "can0", "Channel of the interface; an address of a group with udp_multicast.",
        read_only=True,
    )  # fmt: skip
    port: int = parameter(
        43113, "UDP port of the group with udp_multicast.", low=1, high=65535, read_only=True
    )
    bitrate: int = parameter(
        1_000_000, "Bit rate; socketcan has it from the system.", unit="bit/s", low=10_000,
        high=1_000_000, read_only=True,
    )  # fmt: skip
    protocol: str = parameter(
        "cia402", "What the drives speak.", choices=("cia402", "vesc", "odrive"), read_only=True
    )
    nodes: tuple[int, ...] = parameter(
        (), "Node id of each wheel's drive, in the order of wheels.names.", low=0, high=254,
        read_only=True,
    )  # fmt: skip
    direction: Floats = parameter(
        (1.0,), "1 where the motor turns the wheel forward by counting up, else -1.", low=-1,
        high=1, read_only=True,
    )  # fmt: skip
    gear_ratio: float = parameter(
        0.0, "Turns of the motor per turn of the wheel; 0 takes motor.gear_ratio.", low=0,
        high=10_000, read_only=True,
    )  # fmt: skip
    counts: float = parameter(
        4096.0, "Position units of the drive per turn of the motor (6064; not for VESC, ODrive).",
        low=1, high=1e9, read_only=True,
    )  # fmt: skip
    velocity_scale: float = parameter(
        0.0, "Velocity units of the drive per turn of the motor per second (60FF); 0: counts.",
        low=0, high=1e9, read_only=True,
    )  # fmt: skip
    pole_pairs: int = parameter(
        7, "Pole pairs of the motor (VESC counts electrical turns).", low=1, high=100,
        read_only=True,
    )  # fmt: skip
    rated_torque: float = parameter(
        0.0, "Torque at the motor of which 6071 and 6077 are thousandths; 0 reads 6076.",
        unit="N m", low=0, high=1e4, read_only=True,
    )  # fmt: skip
    mode: str = parameter(
        "velocity", "What wheel commands may ask for besides velocities; the drives must have it.",
        choices=("velocity", "torque", "voltage"), read_only=True,
    )  # fmt: skip
    feed_forward: bool = parameter(
        False, "Whether feed-forward torques are sent with velocities (CiA 402: 60B2; not VESC).",
        read_only=True,
    )  # fmt: skip
    rate: float = parameter(
        200.0, "Rate of setpoints and of SYNC.", unit="Hz", low=10, high=1000, read_only=True
    )
    missed_periods: int = parameter(
        3, "Missed reports of a wheel after which it is lost.", low=1, high=1000
    )
    feedback_period: float = parameter(
        0.0, "Period of the drives' own reports (VESC, ODrive); 0 takes that of the setpoints.",
        unit="s", low=0, high=1, read_only=True,
    )  # fmt: skip
    heartbeat_timeout: float = parameter(
        0.1, "Silence of this host after which CiA 402 drives stop by themselves (1016).",
        unit="s", low=0.01, high=5, read_only=True,
    )  # fmt: skip
    drive_heartbeat: float = parameter(
        0.03, "Period of the drives' heartbeats (1017; others: as configured there).", unit="s",
        low=0.005, high=1, read_only=True,
    )  # fmt: skip
    configure_timeout: float = parameter(
        5.0, "How long the drives may take to be configured.", unit="s", low=0.1, high=60
    )
    enable_timeout: float = parameter(
        2.0, "How long the drives may take to be enabled.", unit="s", low=0.1, high=60
    )
    command_timeout: float = parameter(
        0.1, "Age of the last valid command at which the wheels are ramped to rest.", unit="s",
        low=0.005, high=10,
    )  # fmt: skip
    deceleration: float = parameter(
        9.0, "Ramp of the fastest wheel when the commands are stale.", unit="rad/s^2", low=0.01,
        high=10_000,
    )  # fmt: skip
    acceleration: float = parameter(
        30.0, "Ramp of the fastest wheel to the first command after the wheels were held.",
        unit="rad/s^2", low=0.01, high=10_000,
    )  # fmt: skip
    quick_stop_deceleration: float = parameter(
        9.0, "Ramp of each wheel in a quick stop (6085).", unit="rad/s^2", low=0.01, high=10_000,
        read_only=True,
    )  # fmt: skip
    max_speed: float = parameter(
        0.0, "Largest wheel speed: commands beyond it are refused, wheels at 1.5 times it stop "
        "all; 0 takes 1.2 times motor.max_speed.", unit="rad/s", low=0, high=1e4,
    )  # fmt: skip
    max_torque: float = parameter(
        0.0, "Largest torque at a wheel, others are clipped; 0 takes that of motor.max_current.",
        unit="N m", low=0, high=1e5,
    )  # fmt: skip
    min_bus_voltage: float = parameter(
        0.0, "Measured supply below which all stops.", unit="V", low=0, high=1000
    )

    @property
    def period(self) -> float:
        """Time between two setpoints [s]."""
        return 1.0 / self.rate

    @property
    def feedback_timeout(self) -> float:
        """Age of a wheel's feedback at which it is lost [s]."""
        return self.missed_periods * (self.feedback_period or self.period)

    def check(self, robot: Robot) -> None:
        """Compare the installation with the robot.

        Raises:
            ParameterError: There is not one drive a wheel, a node id is there twice or not
                possible in the protocol, or a direction is neither 1 nor -1.
        """
        n, nodes = robot.wheel_count, self.nodes
        if len(nodes) != n:
            raise ParameterError("can.nodes", nodes, f"{len(nodes)} drives, {n} wheels")
        if len(set(nodes)) != n:
            raise ParameterError("can.nodes", nodes, "a node id is there twice")
        low, high = NODE_IDS[self.protocol]
        for node in nodes:
            if not low <= node <= high:
                reason = f"node ids of {self.protocol} are {low} to {high}"
                raise ParameterError("can.nodes", nodes, reason)
        if len(self.direction) not in (1, n) or any(abs(d) != 1.0 for d in self.direction):
            raise ParameterError("can.direction", self.direction, f"1 or -1, one or {n} of them")

    def directions(self, n: int) -> Floats:
        """Direction of each of n wheels, 1 or -1."""
        return self.direction if len(self.direction) == n else self.direction * n
