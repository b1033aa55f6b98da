"""The table of sockets on which the processes of a robot listen, for documentation and tests."""

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class ListeningSocket:
    """A socket, or several of one kind, on which a process of the robot listens."""

    nodes: tuple[str, ...]  #: Nodes that open it; empty if every node does
    kind: str  #: Transport and ports
    parameters: tuple[str, ...]  #: Parameters with its ports and addresses; empty if it has none
    is_tcp: bool  #: Whether it is a TCP socket
    modules: tuple[str, ...]  #: Modules of the package that open it; empty if the middleware does
    reachable: str  #: From where it can be reached
    admitted: str  #: Who is let in


LISTENING_SOCKETS = (
    ListeningSocket(
        (),
        "DDS: UDP 7400 and above, shared memory",
        (),
        False,
        (),
        "all interfaces, unless `ROS_AUTOMATIC_DISCOVERY_RANGE` or DDS Security says otherwise",
        "every participant of the same `ROS_DOMAIN_ID`",
    ),
    ListeningSocket(
        ("viewer",),
        "TCP 8080 or the next free port",
        ("host", "port"),
        True,
        ("omniman_ros.viewer.page.viser_compat",),
        "this machine; others with another `host`",
        "this machine: pages of its own only, by `Origin` and `Host`; others: those who show the "
        "token",
    ),
    ListeningSocket(
        ("arm_streamer",),
        "TCP, any free port by default",
        ("ur.reverse_host", "ur.reverse_port"),
        True,
        ("omniman_ros.ur.sockets",),
        "the network of the arm's controller",
        "the controller's address alone, once per program that was sent; it is sent setpoints, "
        "and nothing that it sends is obeyed",
    ),
    ListeningSocket(
        ("simulated_ur",),
        "TCP 30001 to 30004 and 29999, or free ports",
        (
            "ports.address",
            "ports.dashboard",
            "ports.primary",
            "ports.secondary",
            "ports.realtime",
            "ports.rtde",
        ),
        True,
        ("omniman_ros.simulation.ur.tcp_ports",),
        "`ports.address`, 127.0.0.1 by default",
        "everybody who connects, as with a real controller",
    ),
    ListeningSocket(
        ("simulated_world",),
        "TCP, off by default",
        ("arm_port",),
        True,
        ("omniman_ros.simulation.link_server",),
        "this machine",
        "one controller at a time",
    ),
    ListeningSocket(
        ("simulated_can_drives",),
        "TCP, with `publish_clock` only, any free port by default",
        ("bus_port",),
        True,
        ("omniman_ros.simulation.link_server",),
        "this machine",
        "one bridge at a time",
    ),
    ListeningSocket(
        ("can_bridge", "simulated_can_drives"),
        "UDP multicast 239.74.163.2 and a free port, with `can.interface` `udp_multicast` "
        "(simulation of a bus)",
        ("can.interface", "can.channel", "can.port"),
        False,
        ("omniman_ros.can_drives.bus", "omniman_ros.nodes.can_receiver"),
        "this machine, unless multicast is routed",
        "everybody who sends CAN frames",
    ),
)  #: All sockets on which a process of the robot listens


def markdown() -> Iterator[str]:
    """Yield the lines of the table for the documentation."""
    yield "| process | socket | parameters | reachable from | who is let in |"
    yield "|---|---|---|---|---|"
    for row in LISTENING_SOCKETS:
        processes = ", ".join(f"`{name}`" for name in row.nodes) or "every node"
        names = ", ".join(f"`{name}`" for name in row.parameters)
        yield f"| {processes} | {row.kind} | {names} | {row.reachable} | {row.admitted} |"
