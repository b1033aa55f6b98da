"""Tests of buttons, numbers and tabs, operated as a page does, without a browser."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest
import viser
from viser._messages import GuiButtonHoldMessage, GuiUpdateMessage

from omniman_ros.planning.cases import CASES, TwoVelocityPath
from omniman_ros.viewer.debounced_value import ECHO_TIME, SETTLING_TIME
from omniman_ros.viewer.events import (
    ButtonHeld,
    ButtonPressed,
    ButtonReleased,
    CaseSelected,
    ObstacleDeleted,
    ObstacleMotionSet,
    ObstaclePathSet,
    ObstacleResized,
    ObstacleSelected,
    ParameterChanged,
    WaypointAdded,
)
from omniman_ros.viewer.obstacle_paths import AtEnd, PathKind, WaypointPath
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.panel import HEARTBEAT, Controls
from omniman_ros.viewer.page.parameter_panel import step
from omniman_ros.viewer.placed_obstacles import PlacedObstacles
from omniman_ros.viewer.view_state import TunableParameter, ViewState

CLIENT = 7


class Bench:
    """The controls on a server without a browser."""

    def __init__(self, server):
        self.gui = server.gui
        self.events = []
        self.state = ViewState(4, 1)
        self.obstacles = PlacedObstacles()
        self.gui._resolve_client = lambda client: object()
        self.clicks = FloorClicks(server.scene, lambda: (0.0, 0.0))
        self.controls = Controls(server, (1.0, 2.0), self.clicks, self.events.append)

    def handle(self, label):
        (found,) = [
            handle
            for handle in self.gui._gui_input_handle_from_uuid.values()
            if handle.label == label
        ]
        return found

    def send(self, message):
        take = {
            GuiUpdateMessage: self.gui._handle_gui_updates,
            GuiButtonHoldMessage: self.gui._handle_gui_button_hold,
        }[type(message)]
        asyncio.run(take(CLIENT, message))

    def click(self, label):
        self.send(GuiUpdateMessage(self.handle(label)._impl.uuid, {"value": True}))

    def hold(self, label):
        self.send(GuiButtonHoldMessage(self.handle(label)._impl.uuid, HEARTBEAT))

    def set(self, label, value):
        self.send(GuiUpdateMessage(self.handle(label)._impl.uuid, {"value": value}))

    def draw(self, now):
        self.state.obstacles = self.obstacles.arrays(now)
        self.controls.draw(self.state, now)

    def settle(self, now):
        """Draw until an entry has settled, and return the events posted since."""
        self.events.clear()
        self.draw(now)
        self.draw(now + SETTLING_TIME + 0.01)
        return self.events


@pytest.fixture(scope="module")
def server():
    made = viser.ViserServer("127.0.0.1", free_port("127.0.0.1", 18380), verbose=False)
    yield made
    made.stop()


@pytest.fixture
def bench(server):
    yield Bench(server)
    server.gui.reset()


@pytest.mark.parametrize(
    ("label", "event"),
    [
        (action.capitalize(), ButtonPressed(action))
        for action in ("stop", "reset", "go", "pause", "resume", "cancel", "restart", "add")
    ]
    + [("Clear trails", ButtonPressed("clear")), ("Delete all", ObstacleDeleted(None))]
    + [(name.capitalize(), CaseSelected(name)) for name in CASES],
)
def test_a_button_posts_the_event_of_its_label(bench, label, event):
    bench.click(label)
    assert bench.events == [event]


def test_a_held_button_posts_its_motion_and_a_click_releases_it(bench):
    bench.hold("Turn left")
    bench.click("Turn left")
    assert bench.events == [ButtonHeld(CLIENT, "turn_left"), ButtonReleased(CLIENT, "turn_left")]


def test_a_chord_of_keys_holds_its_motions_and_releases_the_others(bench):
    bench.hold("forward+left")
    held = {event.motion for event in bench.events if isinstance(event, ButtonHeld)}
    released = {event.motion for event in bench.events if isinstance(event, ButtonReleased)}
    assert held == {"forward", "left"}
    assert released == {"back", "right", "turn_left", "turn_right"}
    bench.events.clear()
    bench.click("forward+left")
    assert bench.events == [ButtonReleased(CLIENT, "forward"), ButtonReleased(CLIENT, "left")]


def test_stop_has_a_panel_without_held_or_dragged_controls(bench):
    """A panel sends only the latest message every 50 ms."""
    beside = [
        handle.label
        for handle in bench.gui._gui_input_handle_from_uuid.values()
        if handle._impl.parent_container_id == bench.handle("Stop")._impl.parent_container_id
    ]
    assert beside == ["Stop", "Reset"]


@pytest.mark.parametrize("node", ["path_interpolator", "whole_body_planner", "mpc_planner"])
def test_a_button_without_a_service_is_disabled(bench, node):
    bench.state.services = frozenset({f"{node}/pause", f"{node}/cancel"})
    bench.draw(1.0)
    disabled = {name: bench.handle(name).disabled for name in ("Pause", "Resume", "Cancel", "Go")}
    assert disabled == {"Pause": False, "Resume": True, "Cancel": False, "Go": True}
    bench.state.goal = (1.0, 0.0, 0.0)
    bench.draw(1.1)
    assert not bench.handle("Go").disabled
    assert not bench.handle("Stop").disabled and not bench.handle("Reset").disabled


def test_the_loaded_case_is_marked(bench):
    bench.state.case = "corridor"
    bench.draw(1.0)
    colours = {name: bench.handle(name.capitalize()).color for name in CASES}
    assert colours == {"free": "gray", "corridor": "blue", "moving": "gray"}


# ---- obstacles --------------------------------------------------------------------------------


@pytest.fixture
def selected(bench):
    """Select one of two obstacles and return its number."""
    bench.obstacles.add(TwoVelocityPath((0.0, 0.0)), 0.0)
    bench.state.selected_obstacle = bench.obstacles.add(
        TwoVelocityPath((1.0, 2.0), (0.3, -0.1)), 0.0, (0.5, 0.2), 0.1
    )
    bench.draw(1.0)
    return bench.state.selected_obstacle


def test_the_displayed_numbers_belong_to_the_selected_obstacle(bench, selected):
    labels = ("length / 2 (m)", "width / 2 (m)", "heading (°)", "x speed (m/s)", "y speed (m/s)")
    assert [bench.handle(name).value for name in labels] == [0.5, 0.2, 5.7, 0.3, -0.1]
    assert not any(bench.handle(name).disabled for name in labels)
    bench.state.selected_obstacle = None
    bench.draw(1.1)
    assert all(bench.handle(name).disabled for name in (*labels, "Delete"))


def test_a_resize_includes_the_unchanged_values(bench, selected):
    bench.set("width / 2 (m)", 0.4)
    assert bench.settle(2.0) == [ObstacleResized(selected, (0.5, 0.4), 0.1)]
    bench.set("heading (°)", 90)
    assert bench.settle(9.0) == [ObstacleResized(selected, (0.5, 0.2), math.pi / 2)]


def test_a_change_of_one_velocity_component_sends_both(bench, selected):
    bench.set("y speed (m/s)", 0.25)
    path = TwoVelocityPath((1.0, 2.0), (0.3, 0.25))
    assert bench.settle(2.0) == [ObstaclePathSet(selected, path)]


def test_a_paused_obstacle_displays_the_velocity_after_the_pause(bench, selected):
    bench.obstacles.pause(2.0)
    bench.state.obstacles_paused = True
    bench.draw(2.0)
    assert bench.handle("x speed (m/s)").value == 0.3
    bench.set("x speed (m/s)", 0.5)
    (event,) = bench.settle(3.0)
    assert event == ObstaclePathSet(selected, TwoVelocityPath((1.0, 2.0), (0.5, -0.1)))
    bench.obstacles.set_path(event.number, event.path, 3.0)
    bench.draw(3.0 + SETTLING_TIME + ECHO_TIME + 0.1)
    assert bench.handle("x speed (m/s)").value == 0.5


def test_an_entry_for_one_obstacle_does_not_apply_to_the_next(bench, selected):
    bench.set("width / 2 (m)", 0.4)
    bench.draw(2.0)
    bench.state.selected_obstacle = 0
    assert bench.settle(2.1) == []
    assert bench.handle("width / 2 (m)").value == 0.25


def test_next_cycles_and_delete_removes_the_selected_obstacle(bench, selected):
    bench.click("Next")
    bench.click("Delete")
    assert bench.events == [ObstacleSelected(0), ObstacleDeleted(selected)]


def test_the_numbers_of_the_kind_of_motion_are_visible(bench, selected):
    def visible():
        labels = ("x speed (m/s)", "turn after (s)", "speed (m/s)", "Loop", "Click floor")
        return [label for label in labels if bench.handle(label).visible]

    assert visible() == ["x speed (m/s)"]
    bench.obstacles.set_motion(selected, PathKind.ONE_TURN, 1.0)
    bench.draw(1.0)
    assert visible() == ["x speed (m/s)", "turn after (s)"]
    bench.obstacles.set_path(selected, WaypointPath(((0.0, 0.0), (1.0, 0.0))), 1.0)
    bench.draw(1.0)
    assert visible() == ["speed (m/s)", "Loop", "Click floor"]
    bench.state.selected_obstacle = None
    bench.draw(1.0)
    assert visible() == ["x speed (m/s)"] and bench.handle("One turn").disabled


@pytest.mark.parametrize("motion", PathKind)
def test_a_button_requests_its_kind_of_motion(bench, selected, motion):
    bench.click(motion.value.capitalize())
    assert bench.events == [ObstacleMotionSet(selected, motion)]


def test_a_turn_is_entered_as_its_time_and_the_velocity_after_it(bench, selected):
    path = TwoVelocityPath((1.0, 2.0), (0.3, 0.0), 4.0, (0.0, 0.2))
    bench.obstacles.set_path(selected, path, 1.0)
    bench.draw(1.0)
    shown = ("x speed (m/s)", "turn after (s)", "then x speed (m/s)", "then y speed (m/s)")
    assert [bench.handle(label).value for label in shown] == [0.3, 4.0, 0.0, 0.2]
    bench.set("turn after (s)", 2.5)
    bench.set("then x speed (m/s)", -0.4)
    bench.set("x speed (m/s)", 0.6)
    path = TwoVelocityPath((1.0, 2.0), (0.6, 0.0), 2.5, (-0.4, 0.2))
    assert bench.settle(2.0) == [ObstaclePathSet(selected, path)]


@pytest.fixture
def walking(bench, selected):
    """Let the selected obstacle follow way points, and return its path."""
    path = WaypointPath(((1.0, 2.0), (3.0, 2.0), (3.0, 4.0)), 0.5)
    bench.obstacles.set_path(selected, path, 1.0)
    bench.draw(1.0)
    return path


def test_speed_and_end_of_the_way_points_are_displayed_and_set(bench, selected, walking):
    assert bench.handle("speed (m/s)").value == 0.5
    colours = {end: bench.handle(end.value.capitalize()).color for end in AtEnd}
    assert colours == {AtEnd.LOOP: "blue", AtEnd.BACK_AND_FORTH: "gray", AtEnd.ONCE: "gray"}
    bench.set("speed (m/s)", 0.8)
    assert bench.settle(2.0) == [ObstaclePathSet(selected, replace(walking, speed=0.8))]
    bench.events.clear()
    bench.click("Once")
    (event,) = bench.events
    assert event.path.at_end is AtEnd.ONCE and event.path.points == walking.points


@pytest.mark.parametrize("speed", [0.0, -1.0, 3.1, math.nan])
def test_a_speed_out_of_range_is_dropped(bench, walking, speed):
    bench.set("speed (m/s)", speed)
    assert bench.settle(2.0) == []


def test_each_way_point_can_be_edited_and_deleted(bench, selected, walking):
    assert [bench.handle(f"point {axis} (m)").value for axis in "xy"] == [3.0, 4.0]
    bench.click("Next point")
    bench.draw(2.0)
    assert [bench.handle(f"point {axis} (m)").value for axis in "xy"] == [1.0, 2.0]
    bench.set("point y (m)", -1.0)
    assert bench.settle(3.0) == [ObstaclePathSet(selected, walking.with_point(0, (1.0, -1.0)))]
    bench.events.clear()
    bench.click("Delete point")
    (event,) = bench.events
    assert event.path.points == ((3.0, 2.0), (3.0, 4.0))


def test_an_entry_for_one_way_point_does_not_apply_to_the_next(bench, walking):
    bench.set("point x (m)", 9.0)
    bench.draw(2.0)
    bench.click("Next point")
    assert bench.settle(2.1) == []


def test_the_only_way_point_cannot_be_deleted(bench, selected):
    bench.obstacles.set_motion(selected, PathKind.WAYPOINTS, 1.0)
    bench.draw(1.0)
    assert bench.handle("Delete point").disabled
    bench.click("Delete point")
    assert bench.events == []


def test_a_way_point_is_added_by_a_button(bench, selected, walking):
    bench.click("Add point")
    assert bench.events == [WaypointAdded(selected, (4.0, 4.0))]
    bench.obstacles.add_waypoint(selected, (4.0, 4.0), 1.0)
    bench.draw(2.0)
    assert bench.handle("point x (m)").value == 4.0, "the new one is displayed"


def test_clicks_on_the_floor_count_from_the_first_way_point_until_done(bench, selected):
    bench.draw(1.0)
    assert not bench.clicks.active
    bench.obstacles.set_motion(selected, PathKind.WAYPOINTS, 1.0)
    bench.draw(1.0)
    assert bench.clicks.active
    bench.click("Done")
    bench.draw(1.1)
    assert not bench.clicks.active
    bench.click("Click floor")
    assert bench.clicks.active


@pytest.mark.parametrize("change", ["deselected", "straight", "deleted"])
def test_clicks_on_the_floor_count_for_the_selected_obstacle_only(bench, selected, change):
    bench.obstacles.set_motion(selected, PathKind.WAYPOINTS, 1.0)
    bench.draw(1.0)
    if change == "deselected":
        bench.state.selected_obstacle = 0
    elif change == "straight":
        bench.obstacles.set_motion(selected, PathKind.STRAIGHT, 1.0)
    else:
        bench.obstacles.delete(selected)
    bench.draw(1.1)
    assert not bench.clicks.active


# ---- the planner ------------------------------------------------------------------------------


@pytest.fixture
def tuned(bench):
    bench.state.planner_parameters = {
        "weights.position": TunableParameter(600.0, 0.0, 1e6, "Weight."),
        "safety.clearance": TunableParameter(0.05, 0.0, 2.0, "Gap."),
    }
    bench.draw(1.0)
    return bench


def test_the_planner_parameters_appear_once_when_they_are_known(tuned):
    tuned.draw(2.0)
    assert tuned.handle("position weight").value == 600.0
    assert tuned.handle("clearance").value == 0.05
    assert tuned.events == []


def test_a_number_is_sent_once_and_not_echoed(tuned):
    tuned.set("position weight", 700)
    assert tuned.settle(2.0) == [ParameterChanged("weights.position", 700.0)]
    tuned.state.planner_parameters["weights.position"] = TunableParameter(
        700.0, 0.0, 1e6, "Weight."
    )
    tuned.events.clear()
    for now in np.arange(2.5, 8.0, 0.1):
        tuned.draw(now)
    assert tuned.events == []
    assert tuned.handle("position weight").value == 700.0


def test_a_value_set_by_another_node_is_displayed_and_not_sent(tuned):
    tuned.state.planner_parameters["safety.clearance"] = TunableParameter(0.1, 0.0, 2.0, "Gap.")
    assert tuned.settle(2.0) == []
    assert tuned.handle("clearance").value == 0.1


def test_a_refused_value_is_replaced_by_that_of_the_node(tuned):
    tuned.set("clearance", 1.5)
    assert len(tuned.settle(2.0)) == 1
    assert tuned.handle("clearance").value == 1.5
    tuned.draw(2.0 + SETTLING_TIME + ECHO_TIME + 0.1)
    assert tuned.handle("clearance").value == 0.05


@pytest.mark.parametrize("garbage", [math.nan, math.inf, -1.0, 2.1])
def test_an_invalid_number_is_dropped(tuned, garbage):
    tuned.set("clearance", garbage)
    assert tuned.settle(2.0) == []
    tuned.draw(2.0 + SETTLING_TIME + ECHO_TIME + 0.1)
    assert tuned.handle("clearance").value == 0.05


def test_no_numbers_are_sent_to_a_missing_planner(tuned):
    tuned.state.planner_parameters = {}
    tuned.draw(2.0)
    assert tuned.handle("clearance").disabled


@pytest.mark.parametrize(
    ("value", "expected"), [(600.0, 20.0), (0.05, 0.002), (1.0, 0.05), (0.0, 0.01), (20.0, 1.0)]
)
def test_a_step_is_a_round_fraction_of_the_value(value, expected):
    assert step(value) == pytest.approx(expected)
