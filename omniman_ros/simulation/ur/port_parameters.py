"""Parameters of the TCP ports, without what serves them: other nodes may read them."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class UrPortParameters(Validated):
    """Address and numbers of the controller's ports."""

    address: str = parameter(
        "127.0.0.1", "Address at which the ports listen; all if 0.0.0.0.", read_only=True
    )
    dashboard: int = parameter(
        29999, "Dashboard; any free port if 0, as below.", low=0, high=65535, read_only=True
    )
    primary: int = parameter(30001, "Programs.", low=0, high=65535, read_only=True)
    secondary: int = parameter(30002, "Programs.", low=0, high=65535, read_only=True)
    realtime: int = parameter(30003, "Programs.", low=0, high=65535, read_only=True)
    rtde: int = parameter(30004, "RTDE.", low=0, high=65535, read_only=True)
