"""What turns the wheels: drives without a bus, on a bus of this machine, or on a real one."""

import os
import zlib
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
BUSES, SPREAD = 240, 80
"""More than there are ROS domains, and how many namespaces get ports of their own."""


def settings_file(kind: str, folder: str, name: str) -> str:
    """Path of a file with parameters: a name of one in config/FOLDER/, or a path.

    Args:
        kind: What it describes, for the message.
        folder: In config/.
        name: Of the file, without .yaml; or its path.

    Raises:
        CommandError: There is none.
    """
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return str(path.resolve())
        raise CommandError(f"no {kind} '{name}'", 2)
    place = share_path("config", folder)
    if (place / f"{name}.yaml").is_file():
        return str(place / f"{name}.yaml")
    known = ", ".join(sorted(file.stem for file in place.glob("*.yaml")))
    raise CommandError(f"no {kind} '{name}'; there are {known}, or give a .yaml file", 2)


def installation_file(name: str) -> str:
    """Path of an installation's file; see :func:`settings_file`."""
    return settings_file("installation", "can", name)


def private_bus(namespace: str = "") -> list[str]:
    """Parameters of a bus on this machine alone, another one in each ROS domain and namespace."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    name = namespace.strip("/").encode()
    port = FIRST_PORT + domain + (BUSES * (1 + zlib.crc32(name) % SPREAD) if name else 0)
    return [
        "-p", "can.interface:=udp_multicast", "-p", f"can.channel:='{MULTICAST}'",
        "-p", f"can.port:={port}",
    ]  # fmt: skip
