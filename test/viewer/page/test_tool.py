"""Tests of the tool's handle and its panel, operated as a page does, without a browser."""

import asyncio
import contextlib
import io
import math

import numpy as np
import pytest
import viser
from viser._messages import GuiUpdateMessage, TransformControlsUpdateMessage

from omniman_ros.viewer.debounced_value import SETTLING_TIME
from omniman_ros.viewer.events import ButtonPressed, ToolHandleMoved
from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.tool_handle import DRAG_TIMEOUT, ToolHandle
from omniman_ros.viewer.page.tool_panel import BUTTONS, ToolPanel
from omniman_ros.viewer.tool_goal import ToolPose
from omniman_ros.viewer.view_state import ViewState

CLIENT = 7
POSE = ToolPose((1.0, 2.0, 0.5), (math.cos(0.25), 0.0, 0.0, math.sin(0.25)))


class Bench:
    """Handle and panel on a server without a browser."""

    def __init__(self, server):
        self.gui, self.api = server.gui, server.scene
        self.gui._resolve_client = self.api._resolve_client = lambda client: object()
        self.events, self.now, self.state = [], 50.0, ViewState(4, 1)
        self.handle = ToolHandle(self.api, "/world", self.events.append, lambda: self.now)
        self.panel = ToolPanel(self.gui, self.events.append)

    @property
    def goal(self):
        return self.state.tool_goal

    def control(self, label):
        (found,) = [
            handle
            for handle in self.gui._gui_input_handle_from_uuid.values()
            if handle.label == label
        ]
        return found

    def set(self, label, value):
        message = GuiUpdateMessage(self.control(label)._impl.uuid, {"value": value})
        asyncio.run(self.gui._handle_gui_updates(CLIENT, message))

    def drag(self, position, rotation):
        message = TransformControlsUpdateMessage("/world/tool_handle", rotation, position)
        asyncio.run(self.api._handle_transform_controls_updates(CLIENT, message))

    def draw(self, seconds=0.05):
        self.now += seconds
        self.handle.draw(self.goal)
        self.panel.draw(self.state, self.now)

    @property
    def drawn(self):
        handle = self.handle._handle
        return handle.visible, handle.position.tolist(), handle.wxyz.tolist()


@pytest.fixture(scope="module")
def server():
    with contextlib.redirect_stdout(io.StringIO()):
        made = viser.ViserServer("127.0.0.1", free_port("127.0.0.1", 18480), verbose=False)
        yield made
        made.stop()


@pytest.fixture
def bench(server):
    yield Bench(server)
    server.gui.reset()
    server.scene.reset()


def test_each_button_posts_its_action_and_needs_a_handle_or_a_tool(bench):
    bench.draw()
    assert all(bench.control(label).disabled for label, _ in BUTTONS.values())
    bench.state.tool = POSE
    bench.goal.place(POSE)
    bench.draw()
    for action, (label, _) in BUTTONS.items():
        assert not bench.control(label).disabled
        bench.set(label, True)
        assert bench.events.pop() == ButtonPressed(action)


def test_the_handle_is_drawn_where_the_node_has_it(bench):
    bench.draw()
    assert not bench.drawn[0]
    bench.goal.place(POSE)
    bench.draw()
    assert bench.drawn == (True, list(POSE.position), pytest.approx(POSE.rotation))
    bench.goal.remove()
    bench.draw()
    assert not bench.drawn[0]


def test_a_drag_posts_the_pose_and_is_not_disturbed_until_it_is_silent(bench):
    bench.goal.place(POSE)
    bench.draw()
    bench.drag((1.5, 2.0, 0.6), (0.0, 1.0, 0.0, 0.0))
    assert bench.events == [ToolHandleMoved((1.5, 2.0, 0.6), (0.0, 1.0, 0.0, 0.0))]
    bench.draw(0.5 * DRAG_TIMEOUT)
    assert bench.drawn[1] == [1.5, 2.0, 0.6]
    # The node has refused it.
    bench.draw(0.6 * DRAG_TIMEOUT)
    assert bench.drawn == (True, list(POSE.position), pytest.approx(POSE.rotation))


def test_added_poses_are_drawn_as_axes_until_there_are_none(bench):
    bench.goal.place(POSE)
    bench.draw()
    assert bench.handle._axes is None
    bench.goal.add()
    bench.draw()
    assert bench.handle._axes.batched_positions.tolist() == [list(POSE.position)]
    bench.goal.remove()
    bench.draw()
    assert bench.handle._axes is None


@pytest.mark.parametrize(
    ("label", "value", "position", "yaw"),
    [
        ("tool z (m)", 0.8, (1.0, 2.0, 0.8), 0.5),
        ("tool yaw (°)", 90.0, POSE.position, 0.5 * math.pi),
    ],
)
def test_a_number_moves_the_handle_without_a_mouse(bench, label, value, position, yaw):
    bench.goal.place(POSE)
    bench.draw(1.0)
    assert bench.control("tool z (m)").value == 0.5
    assert bench.control("tool yaw (°)").value == pytest.approx(math.degrees(0.5), abs=0.05)
    bench.set(label, value)
    bench.draw()
    bench.draw(SETTLING_TIME + 0.01)
    [event] = bench.events
    assert event.position == pytest.approx(position)
    expected = np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
    assert np.array(event.rotation) == pytest.approx(expected, abs=1e-6)
