"""The RViz configuration: no RViz here, so names and topics are held against what is known."""

from xml.etree import ElementTree

import pytest
import yaml

from omniman_ros.cli.main import main
from test.config.documented import ROOT, documented_topics

FILE = ROOT / "config" / "rviz" / "omniman.rviz"

# rviz_default_plugins of Jazzy -> what is on its topic.
DISPLAYS = {
    "Grid": None,
    "TF": None,
    "Map": "nav_msgs/OccupancyGrid",
    "RobotModel": "std_msgs/String",
    "Odometry": "nav_msgs/Odometry",
    "Path": "nav_msgs/Path",
    "Pose": "geometry_msgs/PoseStamped",
    "MarkerArray": "visualization_msgs/MarkerArray",
}
TOOLS = {
    "Interact": None,
    "MoveCamera": None,
    "Select": None,
    "FocusCamera": None,
    "Measure": None,
    "SetGoal": "geometry_msgs/PoseStamped",
    "SetInitialPose": "geometry_msgs/PoseWithCovarianceStamped",
    "PublishPoint": "geometry_msgs/PointStamped",
}
LATCHED = {"map", "robot_description"}


@pytest.fixture(scope="module")
def manager():
    return yaml.safe_load(FILE.read_text())["Visualization Manager"]


def plugin(entry):
    library, name = entry["Class"].split("/")
    assert library == "rviz_default_plugins"
    return name


def main_topic(entry):
    return entry.get("Description Topic") or entry.get("Topic")


def all_topics(tree):
    """Each mapping that is a topic with its quality of service."""
    if isinstance(tree, dict):
        if "Durability Policy" in tree:
            yield tree
        for value in tree.values():
            yield from all_topics(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from all_topics(value)


@pytest.mark.parametrize(("part", "known"), [("Displays", DISPLAYS), ("Tools", TOOLS)])
def test_every_topic_is_one_of_the_robot_with_the_type_that_rviz_takes(manager, part, known):
    documented = documented_topics()
    for entry in manager[part]:
        kind = known[plugin(entry)]
        topic = main_topic(entry)
        assert (topic is None) == (kind is None)
        if topic is not None and topic["Value"] != "clicked_point":  # RViz's own
            assert documented[topic["Value"]] == {kind}, topic


def test_topics_are_relative_so_that_they_follow_the_namespace(manager):
    names = [topic["Value"] for topic in all_topics(manager)]
    assert {"path", "mpc/plan", "mpc/route", "tool_path", "obstacles", "goal_pose"} < set(names)
    assert not [name for name in names if name.startswith("/")]


def test_what_is_latched_is_asked_for_as_latched_and_nothing_else(manager):
    # A publisher that is not latched is not heard by who asks for it.
    asked = {topic["Value"]: topic["Durability Policy"] for topic in all_topics(manager)}
    for name, durability in asked.items():
        assert durability == ("Transient Local" if name in LATCHED else "Volatile"), name
    assert all(topic["Reliability Policy"] == "Reliable" for topic in all_topics(manager))


def test_it_stands_in_odom_and_names_frames_that_there_are(manager, capsys):
    assert manager["Global Options"]["Fixed Frame"] == "odom"
    assert main(["urdf"]) == 0
    robot = ElementTree.fromstring(capsys.readouterr().out)
    links = {link.get("name") for link in robot.iter("link")}
    (tf,) = (entry for entry in manager["Displays"] if plugin(entry) == "TF")
    frames = {name for name, frame in tf["Frames"].items() if isinstance(frame, dict)}
    assert frames - links == {"map", "odom"}


def test_displays_have_names_of_their_own_and_are_on_but_for_the_simulations(manager):
    names = [entry["Name"] for entry in manager["Displays"]]
    assert len(set(names)) == len(names)
    off = [entry["Name"] for entry in manager["Displays"] if not entry["Enabled"]]
    assert off == ["Ground truth (simulation)"]
    assert all(entry["Enabled"] == entry["Value"] for entry in manager["Displays"])
