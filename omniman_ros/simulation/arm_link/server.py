"""The world's end of the link: it listens, and serves one arm controller at a time."""

from omniman_ros.simulation.arm_link.frames import (
    ArmSetpoint,
    ArmState,
    SetpointReader,
    encode_state,
)
from omniman_ros.simulation.link_server import LinkServer


class ArmLinkServer(LinkServer[ArmSetpoint, ArmState]):
    """Receives setpoints and sends states at a port; a ParameterError says it is not available."""

    def __init__(self, port: int) -> None:
        super().__init__("arm_port", port, SetpointReader, encode_state)
