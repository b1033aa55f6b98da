"""Parameters of the wheel drives on a CAN bus: connection, units, limits and timeouts."""

from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated

#: Value of a parameter of all wheels: one for all of them, or one per wheel
Floats = tuple[float, ...]

#: Smallest and largest node id of a drive, by protocol of the package.
#:
#: In CANopen, 127 is the host's node id; 255 addresses all VESCs.
NODE_IDS = {"cia402": (1, 126), "vesc": (0, 254), "odrive": (0, 63)}
#: Ratio of the largest accepted wheel speed to `motor.max_speed`, if `can.max_speed` is 0
HEADROOM = 1.2


@dataclass(frozen=True, kw_only=True)
class CanParameters(Validated):
    """Parameters of the wheel drives on one CAN bus.

    Four hexadecimal digits in a description are the index of a CiA 402 or CANopen object.
    """

    interface: str = parameter(
        "socketcan",
        "Interface of python-can: socketcan, udp_multicast, virtual, slcan, pcan ...",
        read_only=True,
    )
    channel: str = parameter(
        "can0",
        "Channel of the interface; with udp_multicast the address of the multicast group.",
        read_only=True,
    )
    port: int = parameter(
        43113,
        "UDP port of the multicast group with udp_multicast.",
        low=1,
        high=65535,
        read_only=True,
    )
    bitrate: int = parameter(
        1_000_000,
        "Bit rate of the bus; socketcan ignores it, as the system sets it.",
        unit="bit/s",
        low=10_000,
        high=1_000_000,
        read_only=True,
    )
    protocol: str = parameter(
        "cia402",
        "Protocol of the drives: cia402, vesc, odrive, or MODULE:CLASS of a DriveAxis.",
        read_only=True,
    )
    nodes: tuple[int, ...] = parameter(
        (),
        "Node id of each wheel's drive, in the order of wheels.names.",
        low=0,
        high=254,
        read_only=True,
    )
    direction: Floats = parameter(
        (1.0,),
        "1 if a rising motor position turns the wheel forward, else -1; one value or one per "
        "wheel.",
        low=-1,
        high=1,
        read_only=True,
    )
    gear_ratio: float = parameter(
        0.0,
        "Motor revolutions per wheel revolution; 0 uses motor.gear_ratio.",
        low=0,
        high=10_000,
        read_only=True,
    )
    counts: float = parameter(
        4096.0,
        "Position units of a CiA 402 drive per motor revolution (6064).",
        low=1,
        high=1e9,
        read_only=True,
    )
    velocity_scale: float = parameter(
        0.0,
        "Velocity units of a CiA 402 drive (60FF) per motor revolution per second; 0 uses counts.",
        low=0,
        high=1e9,
        read_only=True,
    )
    pole_pairs: int = parameter(
        7,
        "Pole pairs of the motor; a VESC counts electrical revolutions.",
        low=1,
        high=100,
        read_only=True,
    )
    rated_torque: float = parameter(
        0.0,
        "Rated motor torque, in thousandths of which 6071 and 6077 count; 0 reads it from 6076.",
        unit="N m",
        low=0,
        high=1e4,
        read_only=True,
    )
    mode: str = parameter(
        "velocity",
        "Mode of wheel commands allowed besides velocity; the drives must support it.",
        choices=("velocity", "torque", "voltage"),
        read_only=True,
    )
    feed_forward: bool = parameter(
        False,
        "Whether feed-forward torques are sent with velocities (60B2); not with VESC.",
        read_only=True,
    )
    rate: float = parameter(
        200.0, "Rate of setpoints and of SYNC.", unit="Hz", low=10, high=1000, read_only=True
    )
    missed_periods: int = parameter(
        3, "Number of missed reports after which a wheel counts as lost.", low=1, high=1000
    )
    feedback_period: float = parameter(
        0.0,
        "Period at which VESCs and ODrives send reports; 0 uses that of the setpoints.",
        unit="s",
        low=0,
        high=1,
        read_only=True,
    )
    heartbeat_timeout: float = parameter(
        0.1,
        "Time without a heartbeat of this host after which CiA 402 drives stop (1016).",
        unit="s",
        low=0.01,
        high=5,
        read_only=True,
    )
    drive_heartbeat: float = parameter(
        0.03,
        "Period of the drives' heartbeats: written to CiA 402 drives (1017), on others as "
        "configured in the drive.",
        unit="s",
        low=0.005,
        high=1,
        read_only=True,
    )
    configure_timeout: float = parameter(
        5.0, "Longest time to configure the drives.", unit="s", low=0.1, high=60
    )
    enable_timeout: float = parameter(
        2.0, "Longest time to enable the drives.", unit="s", low=0.1, high=60
    )
    command_timeout: float = parameter(
        0.1,
        "Age of the last valid command from which the wheels are ramped down to rest.",
        unit="s",
        low=0.005,
        high=10,
    )
    deceleration: float = parameter(
        9.0,
        "Deceleration of the fastest wheel once the last command is older than command_timeout.",
        unit="rad/s^2",
        low=0.01,
        high=10_000,
    )
    acceleration: float = parameter(
        30.0,
        "Acceleration of the fastest wheel towards the first command after the wheels were held.",
        unit="rad/s^2",
        low=0.01,
        high=10_000,
    )
    quick_stop_deceleration: float = parameter(
        9.0,
        "Deceleration of each wheel in a quick stop (6085).",
        unit="rad/s^2",
        low=0.01,
        high=10_000,
        read_only=True,
    )
    max_speed: float = parameter(
        0.0,
        "Largest wheel speed: commands above it are refused, and a wheel above 1.5 times it stops "
        "all wheels; 0 uses 1.2 times motor.max_speed.",
        unit="rad/s",
        low=0,
        high=1e4,
    )
    max_torque: float = parameter(
        0.0,
        "Largest wheel torque, to which commands are clipped; 0 uses that at motor.max_current.",
        unit="N m",
        low=0,
        high=1e5,
    )
    min_bus_voltage: float = parameter(
        0.0, "Measured supply voltage below which all wheels stop.", unit="V", low=0, high=1000
    )

    @property
    def period(self) -> float:
        """Time between two setpoints [s]."""
        return 1.0 / self.rate

    @property
    def feedback_timeout(self) -> float:
        """Age of a wheel's feedback from which the wheel counts as lost [s]."""
        return self.missed_periods * (self.feedback_period or self.period)

    def check(self, robot: Platform) -> None:
        """Check the parameters against the robot.

        Raises:
            ParameterError: There is not one node id per wheel, a node id is repeated or outside
                the protocol's range, a direction is neither 1 nor -1, there is neither one
                direction nor one per wheel, or the protocol is not a name or MODULE:CLASS.
        """
        n, nodes = robot.wheel_count, self.nodes
        if len(nodes) != n:
            reason = f"must have {n} node ids, one per wheel, has {len(nodes)}"
            raise ParameterError("can.nodes", nodes, reason)
        if len(set(nodes)) != n:
            raise ParameterError("can.nodes", nodes, "must not repeat a node id")
        if self.protocol not in NODE_IDS and ":" not in self.protocol:
            reason = f"must be one of {', '.join(NODE_IDS)}, or MODULE:CLASS of a DriveAxis"
            raise ParameterError("can.protocol", self.protocol, reason)
        low, high = NODE_IDS.get(self.protocol, (0, 254))
        for node in nodes:
            if not low <= node <= high:
                reason = f"must have node ids from {low} to {high} with {self.protocol}"
                raise ParameterError("can.nodes", nodes, reason)
        if len(self.direction) not in (1, n) or any(abs(d) != 1.0 for d in self.direction):
            reason = f"must be 1 or -1, one value or {n}, one per wheel"
            raise ParameterError("can.direction", self.direction, reason)

    def directions(self, n: int) -> Floats:
        """Return the direction of each of n wheels, 1 or -1."""
        return self.direction if len(self.direction) == n else self.direction * n
