"""What turns the wheels: drives without a bus, on a bus of this machine, or on a real one."""

import os
from pathlib import Path

from omniman_ros.cli.errors import CommandError
from omniman_ros.share import share_path

DRIVES = {
    "simulated": "simulated, without a bus",
    "can": "simulated, on a bus of UDP multicast",
    "real": "on the bus of the installation",
}
"""What turns the wheels."""

MULTICAST, FIRST_PORT = "239.74.163.2", 43113
"""Group of python-can's UDP bus, and the port in ROS domain 0."""


def installation_file(name: str) -> str:
    """Path of an installation's file: a name of one in config/can/, or a path.

    Raises:
        CommandError: There is none.
    """
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return str(path.resolve())
        raise CommandError(f"no installation '{name}'", 2)
    folder = share_path("config", "can")
    if (folder / f"{name}.yaml").is_file():
        return str(folder / f"{name}.yaml")
    known = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
    raise CommandError(f"no installation '{name}'; there are {known}, or give a .yaml file", 2)


def private_bus() -> list[str]:
    """Parameters of a bus on this machine alone, another one in each ROS domain."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    return [
        "-p", "can.interface:=udp_multicast", "-p", f"can.channel:='{MULTICAST}'",
        "-p", f"can.port:={FIRST_PORT + domain}",
    ]  # fmt: skip
