"""Choice of the wheel drives: simulated without a bus, simulated on a CAN bus, or real."""

import os
import zlib
from pathlib import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.processes.free_ports import find_free_ports
from omniman_ros.share import share_path

DRIVES = {
    "simulated": "simulated drives without a bus",
    "can": "simulated drives on a bus",
    "real": "the drives on the bus of the installation",
}  #: Descriptions of the values of `--drive`

MULTICAST_GROUP = "239.74.163.2"  #: Multicast group of python-can's UDP bus
FIRST_PORT = 43113  #: UDP port of the bus in ROS domain 0, without a namespace
#: Number of ports reserved for each namespace slot: more than there are ROS domains
PORTS_PER_NAMESPACE = 240
#: Number of slots over which the namespaces of one ROS domain are distributed
NAMESPACE_SLOTS = 80

#: Arguments that lengthen the timeouts of the bus for simulated drives on real time.
#: Unlike real drives, they are processes that may have to wait on a busy machine.
SIMULATED_BUS_TIMEOUTS = (
    "-p",
    "can.missed_periods:=40",
    "-p",
    "can.drive_heartbeat:=0.1",
    "-p",
    "can.heartbeat_timeout:=0.3",
)


def find_settings_file(kind: str, folder: str, name: str) -> str:
    """Return the path of a file, named by path or without `.yaml`, or raise CommandError."""
    path = Path(name).expanduser()
    if path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return str(path.resolve())
        raise CommandError(f"no {kind} '{name}'", 2)
    settings = share_path("config", folder)
    if (settings / f"{name}.yaml").is_file():
        return str(settings / f"{name}.yaml")
    known = ", ".join(sorted(file.stem for file in settings.glob("*.yaml")))
    raise CommandError(f"no {kind} '{name}'; there are {known}, or give a .yaml file", 2)


def find_installation_file(name: str) -> str:
    """Return the path of an installation's file; see :func:`find_settings_file`."""
    return find_settings_file("installation", "can", name)


def private_bus_arguments(namespace: str = "") -> list[str]:
    """Return the arguments of a CAN bus on this machine.

    Each ROS domain has a bus of its own, and so has each namespace in it, unless two of them fall
    into the same of `NAMESPACE_SLOTS` slots.
    """
    domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    name = namespace.strip("/").encode()
    slot = 1 + zlib.crc32(name) % NAMESPACE_SLOTS if name else 0
    return [
        "-p",
        "can.interface:=udp_multicast",
        "-p",
        f"can.channel:='{MULTICAST_GROUP}'",
        "-p",
        f"can.port:={FIRST_PORT + domain + PORTS_PER_NAMESPACE * slot}",
    ]


def simulated_bus_arguments(namespace: str, sim_time: bool) -> dict[str, list[str]]:
    """Return the arguments of bridge and simulated drives, by the node's name.

    On real time, they are on a bus of UDP multicast. In simulated time, which waits for both, they
    exchange frames over TCP, and all timeouts are those of the installation.
    """
    bridge, drives = "can_bridge", "simulated_can_drives"
    if not sim_time:
        shared = [*private_bus_arguments(namespace), *SIMULATED_BUS_TIMEOUTS]
        return {bridge: shared, drives: list(shared)}
    (port,) = find_free_ports(1)
    return {
        bridge: ["-p", f"simulated_bus_port:={port}"],
        drives: ["-p", f"bus_port:={port}"],
    }
