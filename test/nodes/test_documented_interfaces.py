"""Topics and services of each node against the tables of its page, and its parameters' dump."""

import contextlib
import importlib

import pytest
import rclpy
import yaml
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.registry import NODES, node_module, node_specs
from omniman_ros.processes.arm_options import UR_PORTS
from omniman_ros.viewer.node import ViewerNode
from test.config import sros2
from test.config.documented import ROOT, documented_interface
from test.nodes.harness import World, free_domain
from test.nodes.transforms import tf_installed

# Not of the page: what every node of ROS has, what all nodes here have, and simulated time.
COMMON = {"/parameter_events", "/rosout", "/diagnostics", "/clock", "/tf", "/tf_static"}
REAL_TIME = {"can_bridge", "simulated_can_drives", "arm_streamer", "simulated_ur"}
# Where several nodes of a process have one name, rcl gives /rosout to the first.
ELSEWHERE = {"/tf", "/tf_static", "/clock", "/clock/permits", "/rosout"}
LIFECYCLE = {"change_state", "get_state", "get_available_states", "get_available_transitions"}
LIFECYCLE |= {"get_transition_graph"}

# Documented, but there only later: where map_msgs is installed, or while the page has obstacles.
LATER = {
    "collision_monitor": {"map_updates"},
    "mpc_planner": {"map_updates"},
    "obstacle_tracker": {"map_updates"},
    "whole_body_planner": {"map_updates"},
    "viewer": {"obstacles"},
    # With `imu.use` only.
    "platform_controller": {"imu"},
    "odometry": {"imu"},
}


def parameters_of(name):
    parameters = {"robot": "omniman", "use_sim_time": name not in REAL_TIME}
    if name in ("can_bridge", "arm_streamer"):
        parameters["autostart"] = False
    if name in ("can_bridge", "simulated_can_drives"):
        parameters |= {"can.interface": "virtual", "can.nodes": [1, 2, 3, 4]}
    if name == "simulated_ur":
        parameters |= {f"ports.{name}": 0 for name in UR_PORTS}  # any that are free
    return parameters


def relative(name):
    return name if name in COMMON else name.lstrip("/")


def types(entities, name_of):
    found = {}
    for entity in entities:
        kind = f"{entity.msg_type.__module__.partition('.')[0]}/{entity.msg_type.__name__}"
        found[relative(name_of(entity))] = kind
    return {name: kind for name, kind in found.items() if name not in COMMON}


@pytest.fixture(scope="module", params=list(NODES))
def node(request):
    """The name of a node, the node, and its world."""
    module = importlib.import_module(node_module(request.param))
    (make,) = (
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Node) and kind.__module__ == module.__name__
    )
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(pytest.skip.Exception):  # nodes do without tf2_msgs, too
            stack.enter_context(tf_installed())
        world = stack.enter_context(World(make, parameters=parameters_of(request.param)))
        (running,) = world.nodes
        if isinstance(running, ViewerNode):
            running._topics.set_watched(True)  # as while a browser is connected
        world._await(lambda: is_in_graph(request.param, running), "the node in the graph")
        yield request.param, running, world


def is_in_graph(name, running):
    """Whether the middleware has discovered the node's own endpoints; it does so in a thread."""
    used = sros2.used(name, running)
    return {publisher.topic_name for publisher in running.publishers} <= used[
        "topics", "publish"
    ] and {subscription.topic_name for subscription in running.subscriptions} <= used[
        "topics", "subscribe"
    ]


@pytest.mark.parametrize(
    ("heading", "entities"),
    [("Published topics", "publishers"), ("Subscribed topics", "subscriptions")],
)
def test_topics_are_those_of_the_page(node, heading, entities):
    name, running, _ = node
    documented = documented_interface(name, heading)
    documented = {topic: kind for topic, kind in documented.items() if topic not in COMMON}
    actual = types(getattr(running, entities), lambda entity: entity.topic_name)
    assert actual.items() <= documented.items()
    assert set(documented) - set(actual) <= LATER.get(name, set())


def test_services_are_those_of_the_page(node):
    name, running, _ = node
    own = {
        service.srv_name: service.srv_type.__module__.partition(".")[0]
        + f"/{service.srv_type.__name__}"
        for service in running.services
        if service.srv_name.startswith("~/")
    }
    assert own == documented_interface(name, "Services")
    lifecycle = {service.srv_name.rpartition("/")[2] for service in running.services} & LIFECYCLE
    page = (ROOT / "docs" / "nodes" / f"{name}.md").read_text(encoding="utf-8")
    assert bool(lifecycle) == ("services of a lifecycle node" in page)


def test_the_sros2_policy_allows_what_the_node_uses_and_little_else(node):
    """Else: what is there later, what needs a package that PyPI has not, and simulated time."""
    name, running, _ = node
    allowed, used = sros2.allowed(name), sros2.used(name, running)
    later = {f"/{topic}" for topic in LATER.get(name, set())}
    assert later <= allowed["topics", "publish"] | allowed["topics", "subscribe"]
    for rule, names in used.items():
        assert names <= allowed[rule], rule
        if rule != ("services", "request"):
            assert allowed[rule] - names <= later | ELSEWHERE, rule
    served = (spec.default for spec in node_specs(name) if spec.name.endswith("_action"))
    assert allowed["actions", "execute"] == {sros2.absolute(action, name) for action in served}


def test_the_sros2_policy_has_every_node_and_the_page_may_stop_each_that_has_a_stop():
    assert set(sros2.enclaves()) == {f"/omniman/{name}" for name in NODES}
    stops = {
        service
        for name in NODES
        for service in sros2.allowed(name)["services", "reply"]
        if service.rpartition("/")[2] in ("stop", "reset", "pause", "resume", "cancel")
    }
    assert len(stops) > 10
    requested = sros2.allowed("viewer")["services", "request"]
    assert stops - requested <= {f"/station_keeper/{action}" for action in ("cancel", "pause")}


def dump(world, name):
    """Return what `ros2 param dump` prints (ros2param/verb/dump.py)."""

    def insert(tree, key, value):
        group, _, rest = key.partition(".")
        if rest:
            insert(tree.setdefault(group, {}), rest, value)
        else:
            tree[key] = value

    listed = world.call(ListParameters, f"/{name}/list_parameters").result.names
    request = GetParameters.Request(names=sorted(listed))
    values = world.call(GetParameters, f"/{name}/get_parameters", request).values
    assert len(values) == len(listed)
    tree = {}
    for key, value in zip(request.names, values, strict=True):
        assert value.type != ParameterType.PARAMETER_NOT_SET, key
        insert(tree, key, parameter_value_to_python(value))
    return yaml.dump({f"/{name}": {"ros__parameters": tree}}, default_flow_style=False)


def test_what_ros2_param_dump_prints_gives_the_same_parameters_again(node, tmp_path):
    name, running, world = node
    file = tmp_path / "dump.yaml"
    file.write_text(dump(world, name))
    context = rclpy.Context()
    context.init(args=["--ros-args", "--params-file", str(file)], domain_id=free_domain())
    try:
        again = Node(name, context=context)
        kind, has_robot = type(running.settings.value), running.has_parameter("robot")
        assert ParameterSet(again, kind, robot=has_robot).value == running.settings.value
        for key, parameter in running.get_parameters_by_prefix("").items():
            other = again.get_parameter(key)
            assert (other.type_, other.value) == (parameter.type_, parameter.value), key
        again.destroy_node()
    finally:
        context.shutdown()
