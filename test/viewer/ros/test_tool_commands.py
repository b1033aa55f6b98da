"""Tests of the tool's goal: page events and the resulting messages."""

import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from omniman_ros.viewer.events import ToolHandleMoved
from omniman_ros.viewer.tool_goal import ToolPose
from test.viewer.ros.fake_page import post, press, until, view

TURNED = (math.cos(0.3), 0.0, 0.0, math.sin(0.3))


class Bench:
    """The viewer with a tool that the test reports."""

    def __init__(self, world):
        self.world, self.state = world, world.nodes[-1].state
        self.paths = []
        self.tool = world.publisher(PoseStamped, "tool_pose")
        world.probe.create_subscription(Path, "tool_path", self.paths.append, 10)
        tool = world.nodes[-1]._commands._actions["tool_send"].__self__
        until(world, lambda: tool._paths.get_subscription_count() == 2, "the probe", 0.005)

    def report(self, position=(0.5, 0.1, 0.9), frame="odom"):
        message = PoseStamped()
        message.header.frame_id = frame
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = position
        q.w, q.x, q.y, q.z = TURNED
        self.tool.publish(message)
        self.world.run(0.1)


@pytest.fixture
def bench():
    with view() as world:
        world.run(0.1)
        yield Bench(world)


def poses(path):
    return [
        ((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
        for p, q in ((each.pose.position, each.pose.orientation) for each in path.poses)
    ]


def test_the_handle_is_placed_at_the_tool_and_a_path_leads_through_the_poses_to_it(bench):
    bench.report()
    press(bench.world, "tool_place", 0.1)
    assert bench.state.tool_goal.handle.position == (0.5, 0.1, 0.9)
    first, second = (1.0, 0.0, 0.8), (1.5, -0.2, 0.7)
    post(bench.world, ToolHandleMoved(first, TURNED))
    press(bench.world, "tool_add", 0.1)
    post(bench.world, ToolHandleMoved(second, (2.0, 0.0, 0.0, 0.0)))
    assert not bench.paths
    press(bench.world, "tool_send", 0.2)
    [path] = bench.paths
    assert path.header.frame_id == "odom"
    assert poses(path) == [(first, pytest.approx(TURNED)), (second, (1.0, 0.0, 0.0, 0.0))]
    assert "path of the tool sent, poses: 2" in bench.state.note
    # The next path begins anew, from the handle on.
    press(bench.world, "tool_send", 0.2)
    assert [len(each.poses) for each in bench.paths] == [2, 1]


def test_without_the_tools_pose_there_is_no_handle_and_nothing_is_sent(bench):
    press(bench.world, "tool_place", 0.1)
    assert "it is not known where the tool is" in bench.state.note
    press(bench.world, "tool_send", 0.2)
    assert "there is no handle yet" in bench.state.note
    bench.report(frame="elsewhere")
    assert bench.state.tool is None
    bench.report()
    bench.world.run(3.0)
    press(bench.world, "tool_place", 0.1)
    assert bench.state.tool_goal.handle is None, "the pose is old"
    assert not bench.paths


@pytest.mark.parametrize("position", [(math.nan, 0.0, 1.0), (0.0, 1e9, 1.0)])
def test_a_handle_that_is_moved_nowhere_stays(bench, position):
    bench.report()
    press(bench.world, "tool_place", 0.1)
    post(bench.world, ToolHandleMoved(position, TURNED))
    assert bench.state.tool_goal.handle.position == (0.5, 0.1, 0.9)
    assert "tool: position" in bench.state.note


@pytest.mark.parametrize(
    ("events", "note"),
    [
        (
            ["refused: old", "planning: x", "refused: out of reach", "refused: later"],
            "out of reach",
        ),
        (["none: ", "started: on its way", "refused: later"], "path of the tool sent"),
    ],
)
def test_why_a_path_is_refused_is_noted_once_unless_the_report_is_older(bench, events, note):
    bench.report()
    press(bench.world, "tool_place", 0.1)
    press(bench.world, "tool_send", 0.1)
    diagnostics = bench.world.publisher(DiagnosticArray, "/diagnostics")
    for event, _, text in (each.partition(": ") for each in events):
        values = [
            KeyValue(key="tool_path_event", value=event),
            KeyValue(key="tool_path_last", value=text),
        ]
        status = DiagnosticStatus(name="/path_interpolator", values=values)
        diagnostics.publish(DiagnosticArray(status=[status]))
        bench.world.run(0.1)
    assert note in bench.state.note
    assert bench.state.tool_reports is None


def test_a_removed_handle_takes_its_path_along(bench):
    bench.report()
    for action in ("tool_place", "tool_add", "tool_remove"):
        press(bench.world, action, 0.1)
    assert bench.state.tool_goal.handle is None
    press(bench.world, "tool_send", 0.2)
    assert not bench.paths
    assert isinstance(bench.state.tool, ToolPose)
