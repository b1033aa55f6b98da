"""The PlotJuggler layout: no PlotJuggler here, so its series are held against what is said."""

from xml.etree import ElementTree

import pytest

from omniman_ros.conversions.coupling import coupling_names
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters
from test.config.documented import ROOT, documented_topics

WHEELS = build(Platform, robot_parameters("omniman")).wheels.names
JOINTS = ArmParameters().joints
STATUS = ("solve_ms", "slack_m", "distance_m")


@pytest.fixture(scope="module")
def layout():
    return ElementTree.parse(ROOT / "config" / "plotjuggler" / "omniman.xml").getroot()


def series_of(topic, kind):
    """Series that PlotJuggler makes of a topic, as far as they are used."""
    if kind == "sensor_msgs/JointState":
        names = JOINTS if topic.startswith("arm") else WHEELS
        names = tuple(coupling_names(1)) if topic == "coupling_error" else names
        return {
            f"/{topic}/{n}/{part}" for n in names for part in ("position", "velocity", "effort")
        }
    if kind == "nav_msgs/Odometry":
        twist = {f"/{topic}/twist/twist/{part}" for part in ("linear/x", "linear/y", "angular/z")}
        return twist | {f"/{topic}/pose/pose/position/{axis}" for axis in "xy"}
    if kind == "geometry_msgs/Twist":
        return {f"/{topic}/{part}" for part in ("linear/x", "linear/y", "angular/z")}
    if kind == "std_msgs/Float64":
        return {f"/{topic}/data"}
    if kind == "std_msgs/Float64MultiArray":
        return {f"/{topic}/data[{i}]" for i in range(12)}
    raise AssertionError(kind)


def curves(layout):
    """Names of all series, those of a way in the plane as its two axes."""
    for curve in layout.iter("curve"):
        if "curve_x" in curve.attrib:
            assert curve.get("name") == curve.get("curve_x")[:-1] + "[x;y]"
            yield from (curve.get("curve_x"), curve.get("curve_y"))
        else:
            yield curve.get("name")


def selected(layout):
    lists = {
        plugin.get("ID"): plugin.find("selected_topics").get("value").split(";")
        for plugin in layout.iter("plugin")
    }
    assert set(lists) == {"DataLoad ROS2 bags", "ROS2 Topic Subscriber"}
    first, second = lists.values()
    assert first == second
    return first


def test_every_topic_that_is_selected_is_one_of_the_robot_and_is_plotted(layout):
    documented = documented_topics()
    names = set(curves(layout))
    for topic in selected(layout):
        assert any(name.startswith(f"{topic}/") for name in names), topic
        assert topic == "/diagnostics" or topic[1:] in documented


def test_every_series_is_one_of_a_topic_that_is_selected(layout):
    documented = documented_topics()
    known = {f"/diagnostics//mpc_planner/{key}" for key in STATUS}
    for topic in selected(layout):
        for kind in documented.get(topic[1:], ()):
            known |= series_of(topic[1:], kind)
    names = list(curves(layout))
    assert len(names) > 40
    assert not set(names) - known


def test_each_wheel_and_each_joint_has_its_lines(layout):
    names = set(curves(layout))
    for k, wheel in enumerate(WHEELS):
        assert {f"/wheel_states/{wheel}/velocity", f"/wheel_commands/{wheel}/velocity"} < names
        assert {f"/wheel_electrical/data[{3 * k + i}]" for i in range(3)} < names
    assert {f"/arm/joint_states/{joint}/position" for joint in JOINTS} < names


def test_the_planner_tells_the_keys_that_are_plotted():
    source = (ROOT / "omniman_ros" / "nodes" / "mpc_planner" / "node.py").read_text()
    for key in STATUS:
        assert f'("{key}",' in source


def test_every_panel_has_a_share_of_its_tab(layout):
    splitters = list(layout.iter("DockSplitter"))
    assert len(splitters) == len(list(layout.iter("Tab"))) == 6
    for splitter in splitters:
        fractions = [float(size) for size in splitter.get("sizes").split(";")]
        assert len(fractions) == int(splitter.get("count")) == len(splitter.findall("DockArea"))
        assert sum(fractions) == pytest.approx(1.0, abs=1e-3)
