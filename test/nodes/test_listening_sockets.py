"""The table of listening sockets against the sources, the parameters and running nodes."""

import ast
import os
import re
import socket
from pathlib import Path

import pytest

import omniman_ros
from omniman_ros.extras import WORLD
from omniman_ros.nodes.listening_sockets import LISTENING_SOCKETS, markdown
from omniman_ros.nodes.registry import NODES, node_specs
from test.nodes.harness import World
from test.nodes.test_documented_interfaces import parameters_of
from test.nodes.test_fuzz import make_class
from test.tiers import representative

PACKAGE = Path(omniman_ros.__file__).parent
LISTEN = "0A"  #: State of a listening socket in /proc/net/tcp
#: Modules that listen for a moment, to see whether a port is free
PROBES = {"omniman_ros.processes.free_ports"}
#: What a module uses that opens a socket for others, by the library that it imports for it
OPENERS = {"socket": {"bind", "listen"}, "viser": {"ViserServer"}, "can": {"Bus"}}
#: What is in the text of each of them; it spares the syntax trees of all others
OPENING = re.compile(r"\bcreate_server\(|\.bind\(|ViserServer\)|\bcan\.Bus\(")
CONNECTED = {"ur.host", "ur.dashboard_port", "ur.script_port", "ur.rtde_port"}
CONNECTED |= {"simulated_arm.world_port", "simulated_bus_port"}
"""Parameters with addresses and ports that a node connects to."""
SWITCHED_ON = {
    "simulated_can_drives": {"publish_clock": True},
    "simulated_world": {"arm_port": "free"},
}  #: Parameters with which the optional sockets of a node are opened
ROWS_OF = {name: [row for row in LISTENING_SOCKETS if name in row.nodes] for name in NODES}
FIRST = "simulated_can_drives"
#: Nodes that are made here; a browser tests the page's server
RUN = sorted(set(NODES) - {"viewer"}, key=lambda name: (name != FIRST, name))


def opens(path):
    """Return the libraries by which a module opens sockets for others."""
    text = path.read_text(encoding="utf-8")
    if not OPENING.search(text):
        return set()
    tree = ast.parse(text)
    imported, names = set(), set()
    for item in ast.walk(tree):
        if isinstance(item, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in item.names}
        elif isinstance(item, ast.Call) and isinstance(item.func, ast.Attribute):
            names.add(item.func.attr)
        elif isinstance(item, ast.ClassDef):
            names |= {base.attr for base in item.bases if isinstance(base, ast.Attribute)}
    if "create_server" in names:
        names |= OPENERS["socket"]
    return {
        library for library, opener in OPENERS.items() if library in imported and opener <= names
    }


def test_each_module_that_listens_is_in_the_table():
    found = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for path in PACKAGE.rglob("*.py")
        if "lab" not in path.relative_to(PACKAGE).parts and opens(path)
    }
    assert found - PROBES == {each for row in LISTENING_SOCKETS for each in row.modules}
    assert found >= PROBES


def test_each_address_and_port_that_a_node_listens_at_is_in_the_table():
    for name in NODES:
        listed = {parameter for row in ROWS_OF[name] for parameter in row.parameters}
        declared = {spec.name for spec in node_specs(name)}
        assert listed <= declared
        ends = {"host", "address", "port"}
        places = {each for each in declared if each.rpartition(".")[2].rpartition("_")[2] in ends}
        places |= {each for each in declared if each.startswith("ports.")}
        assert places - CONNECTED <= listed, name


def test_rows_are_on_the_page_in_order():
    lines = list(markdown())[2:]
    assert len(lines) == len(LISTENING_SOCKETS)
    for line, row in zip(lines, LISTENING_SOCKETS, strict=True):
        assert all(f"`{name}`" in line for name in (*row.nodes, *row.parameters))
        assert row.admitted in line and row.reachable in line


def listening():
    """Return the addresses at which this process listens by TCP: host and port."""
    own = set()
    for name in os.listdir("/proc/self/fd"):
        try:
            own.add(os.readlink(f"/proc/self/fd/{name}"))
        except OSError:
            continue  # of this listing itself
    found = set()
    for line in Path("/proc/self/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[3] == LISTEN and f"socket:[{fields[9]}]" in own:
            host, port = fields[1].split(":")
            found.add((socket.inet_ntoa(bytes.fromhex(host)[::-1]), int(port, 16)))
    return found


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


@pytest.mark.parametrize("name", representative(RUN, every=8))
def test_a_node_listens_on_this_machine_and_only_if_the_table_says_so(name):
    if name == "simulated_world" and not WORLD.is_available:
        pytest.skip("without the physics engine")
    more = {
        key: free_port() if value == "free" else value
        for key, value in SWITCHED_ON.get(name, {}).items()
    }
    before = listening()
    with World(make_class(name), parameters=parameters_of(name) | more) as world:
        world.run(0.05)
        opened = listening() - before
    ports = [
        parameter
        for row in ROWS_OF[name]
        if row.is_tcp
        for parameter in row.parameters
        if parameter.rpartition(".")[2] not in ("address", "host")
    ]
    if name == "arm_streamer":  # it listens in a process of its own, once it is configured
        ports = []
    assert len(opened) == len(ports)
    assert {host for host, _ in opened} <= {"127.0.0.1"}
