"""Tests of buttons, numbers and tabs, operated as a page does, without a browser."""

import asyncio
import math

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
    ObstacleResized,
    ObstacleSelected,
    ObstacleVelocitySet,
    ParameterChanged,
)
from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.panel import HEARTBEAT, Controls
from omniman_ros.viewer.page.parameter_panel import label, step
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
        self.controls = Controls(server, (1.0, 2.0), self.events.append)

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


@pytest.mark.parametrize("node", ["path_interpolator", "mpc_planner"])
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
    assert bench.settle(2.0) == [ObstacleVelocitySet(selected, (0.3, 0.25))]


def test_a_paused_obstacle_displays_the_velocity_after_the_pause(bench, selected):
    bench.obstacles.pause(2.0)
    bench.state.obstacles_paused = True
    bench.draw(2.0)
    assert bench.handle("x speed (m/s)").value == 0.3
    bench.set("x speed (m/s)", 0.5)
    assert bench.settle(3.0) == [ObstacleVelocitySet(selected, (0.5, -0.1))]
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


def test_a_parameter_is_displayed_with_a_readable_name():
    assert label("weights.position") == "position weight"
    assert label("safety.least_clearance") == "least clearance"


@pytest.mark.parametrize(
    ("value", "expected"), [(600.0, 20.0), (0.05, 0.002), (1.0, 0.05), (0.0, 0.01), (20.0, 1.0)]
)
def test_a_step_is_a_round_fraction_of_the_value(value, expected):
    assert step(value) == pytest.approx(expected)
