"""Buttons, numbers and tabs, pressed as a page presses them, without a browser."""

import asyncio
import math

import numpy as np
import pytest

from omniman_ros.planning.cases import CASES, Turned
from omniman_ros.viewer.crowd import Crowd
from omniman_ros.viewer.events import (
    CaseChosen,
    Held,
    ObstacleChosen,
    ObstacleDeleted,
    ObstacleSent,
    ObstacleShaped,
    Pressed,
    Released,
    Tuned,
)
from omniman_ros.viewer.settling import PATIENCE, QUIET
from omniman_ros.viewer.state import Picture, Tunable

viser = pytest.importorskip("viser", reason="viser is not installed (extra 'viewer')")

from viser._messages import GuiButtonHoldMessage, GuiUpdateMessage  # noqa: E402

from omniman_ros.viewer.page import free_port  # noqa: E402
from omniman_ros.viewer.panel import HEARTBEAT, Controls  # noqa: E402
from omniman_ros.viewer.tuning_panel import label, step  # noqa: E402

CLIENT = 7


class Bench:
    """Controls on a server that no browser visits."""

    def __init__(self, server):
        self.gui = server.gui
        self.events = []
        self.picture = Picture(4, 1)
        self.crowd = Crowd()
        self.gui._resolve_client = lambda client: object()
        self.controls = Controls(server, (1.0, 2.0), self.events.append)

    def handle(self, label):
        (found,) = [
            handle for handle in self.gui._gui_input_handle_from_uuid.values()
            if handle.label == label
        ]  # fmt: skip
        return found

    def say(self, message):
        take = {
            GuiUpdateMessage: self.gui._handle_gui_updates,
            GuiButtonHoldMessage: self.gui._handle_gui_button_hold,
        }[type(message)]
        asyncio.run(take(CLIENT, message))

    def click(self, label):
        self.say(GuiUpdateMessage(self.handle(label)._impl.uuid, {"value": True}))

    def hold(self, label):
        self.say(GuiButtonHoldMessage(self.handle(label)._impl.uuid, HEARTBEAT))

    def set(self, label, value):
        self.say(GuiUpdateMessage(self.handle(label)._impl.uuid, {"value": value}))

    def draw(self, now):
        self.picture.crowd = self.crowd.rows(now)
        self.controls.draw(self.picture, now)

    def settle(self, now):
        """Draw until what was set is sent; returns what that was."""
        self.events.clear()
        self.draw(now)
        self.draw(now + QUIET + 0.01)
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
    [(action.capitalize(), Pressed(action)) for action in
     ("stop", "reset", "go", "pause", "resume", "cancel", "restart", "add")]
    + [("Clear trails", Pressed("clear")), ("Delete all", ObstacleDeleted(None))]
    + [(name.capitalize(), CaseChosen(name)) for name in CASES],
)  # fmt: skip
def test_a_button_says_what_is_on_it(bench, label, event):
    bench.click(label)
    assert bench.events == [event]


def test_a_button_that_is_held_says_so_and_is_released_by_a_click(bench):
    bench.hold("Turn left")
    bench.click("Turn left")
    assert bench.events == [Held(CLIENT, "turn_left"), Released(CLIENT, "turn_left")]


def test_a_chord_of_keys_holds_its_motions_and_releases_the_others(bench):
    bench.hold("forward+left")
    held = {event.motion for event in bench.events if isinstance(event, Held)}
    released = {event.motion for event in bench.events if isinstance(event, Released)}
    assert held == {"forward", "left"}
    assert released == {"back", "right", "turn_left", "turn_right"}
    bench.events.clear()
    bench.click("forward+left")
    assert bench.events == [Released(CLIENT, "forward"), Released(CLIENT, "left")]


def test_stop_shares_its_panel_with_nothing_that_is_held_or_dragged(bench):
    """A panel sends one message in 50 ms, the latest."""
    beside = [
        handle.label for handle in bench.gui._gui_input_handle_from_uuid.values()
        if handle._impl.parent_container_id == bench.handle("Stop")._impl.parent_container_id
    ]  # fmt: skip
    assert beside == ["Stop", "Reset"]


@pytest.mark.parametrize("node", ["path_interpolator", "mpc_planner"])
def test_what_nobody_serves_cannot_be_pressed(bench, node):
    bench.picture.services = frozenset({f"{node}/pause", f"{node}/cancel"})
    bench.draw(1.0)
    disabled = {name: bench.handle(name).disabled for name in ("Pause", "Resume", "Cancel", "Go")}
    assert disabled == {"Pause": False, "Resume": True, "Cancel": False, "Go": True}
    bench.picture.goal = (1.0, 0.0, 0.0)
    bench.draw(1.1)
    assert not bench.handle("Go").disabled
    assert not bench.handle("Stop").disabled and not bench.handle("Reset").disabled


def test_the_case_that_is_loaded_is_marked(bench):
    bench.picture.case = "corridor"
    bench.draw(1.0)
    colours = {name: bench.handle(name.capitalize()).color for name in CASES}
    assert colours == {"free": "gray", "corridor": "blue", "moving": "gray"}


# ---- obstacles --------------------------------------------------------------------------------


@pytest.fixture
def chosen(bench):
    """Number of an obstacle that is chosen, beside another."""
    bench.crowd.add(Turned((0.0, 0.0)), 0.0)
    bench.picture.chosen = bench.crowd.add(Turned((1.0, 2.0), (0.3, -0.1)), 0.0, (0.5, 0.2), 0.1)
    bench.draw(1.0)
    return bench.picture.chosen


def test_the_numbers_are_those_of_the_obstacle_that_is_chosen(bench, chosen):
    labels = ("length / 2 (m)", "width / 2 (m)", "heading (°)", "x speed (m/s)", "y speed (m/s)")
    assert [bench.handle(name).value for name in labels] == [0.5, 0.2, 5.7, 0.3, -0.1]
    assert not any(bench.handle(name).disabled for name in labels)
    bench.picture.chosen = None
    bench.draw(1.1)
    assert all(bench.handle(name).disabled for name in (*labels, "Delete"))


def test_a_shape_is_sent_with_what_was_not_changed(bench, chosen):
    bench.set("width / 2 (m)", 0.4)
    assert bench.settle(2.0) == [ObstacleShaped(chosen, (0.5, 0.4), 0.1)]
    bench.set("heading (°)", 90)
    assert bench.settle(9.0) == [ObstacleShaped(chosen, (0.5, 0.2), math.pi / 2)]


def test_a_velocity_is_sent_whole(bench, chosen):
    bench.set("y speed (m/s)", 0.25)
    assert bench.settle(2.0) == [ObstacleSent(chosen, (0.3, 0.25))]


def test_the_velocity_of_one_that_is_held_is_what_it_will_be(bench, chosen):
    bench.crowd.hold(2.0)
    bench.picture.holding = True
    bench.draw(2.0)
    assert bench.handle("x speed (m/s)").value == 0.3
    bench.set("x speed (m/s)", 0.5)
    assert bench.settle(3.0) == [ObstacleSent(chosen, (0.5, -0.1))]
    bench.draw(3.0 + QUIET + PATIENCE + 0.1)
    assert bench.handle("x speed (m/s)").value == 0.5


def test_what_was_typed_for_one_obstacle_does_not_go_to_the_next(bench, chosen):
    bench.set("width / 2 (m)", 0.4)
    bench.draw(2.0)
    bench.picture.chosen = 0
    assert bench.settle(2.1) == []
    assert bench.handle("width / 2 (m)").value == 0.25


def test_next_goes_round_and_delete_takes_the_one_that_is_chosen(bench, chosen):
    bench.click("Next")
    bench.click("Delete")
    assert bench.events == [ObstacleChosen(0), ObstacleDeleted(chosen)]


# ---- the planner ------------------------------------------------------------------------------


@pytest.fixture
def tuned(bench):
    bench.picture.tunables = {
        "weights.position": Tunable(600.0, 0.0, 1e6, "Weight."),
        "safety.clearance": Tunable(0.05, 0.0, 2.0, "Gap."),
    }
    bench.draw(1.0)
    return bench


def test_the_planners_numbers_appear_when_they_are_known_and_once(tuned):
    tuned.draw(2.0)
    assert tuned.handle("position weight").value == 600.0
    assert tuned.handle("clearance").value == 0.05
    assert tuned.events == []


def test_a_number_is_sent_once_and_not_echoed(tuned):
    tuned.set("position weight", 700)
    assert tuned.settle(2.0) == [Tuned("weights.position", 700.0)]
    tuned.picture.tunables["weights.position"] = Tunable(700.0, 0.0, 1e6, "Weight.")
    tuned.events.clear()
    for now in np.arange(2.5, 8.0, 0.1):
        tuned.draw(now)
    assert tuned.events == []
    assert tuned.handle("position weight").value == 700.0


def test_a_value_that_somebody_else_has_set_is_shown_and_not_sent(tuned):
    tuned.picture.tunables["safety.clearance"] = Tunable(0.1, 0.0, 2.0, "Gap.")
    assert tuned.settle(2.0) == []
    assert tuned.handle("clearance").value == 0.1


def test_a_value_that_the_node_refuses_gives_way_to_what_it_has(tuned):
    tuned.set("clearance", 1.5)
    assert len(tuned.settle(2.0)) == 1
    assert tuned.handle("clearance").value == 1.5
    tuned.draw(2.0 + QUIET + PATIENCE + 0.1)
    assert tuned.handle("clearance").value == 0.05


@pytest.mark.parametrize("garbage", [math.nan, math.inf, -1.0, 2.1])
def test_a_number_that_cannot_be_is_dropped(tuned, garbage):
    tuned.set("clearance", garbage)
    assert tuned.settle(2.0) == []
    tuned.draw(2.0 + QUIET + PATIENCE + 0.1)
    assert tuned.handle("clearance").value == 0.05


def test_a_planner_that_is_gone_takes_no_numbers(tuned):
    tuned.picture.tunables = {}
    tuned.draw(2.0)
    assert tuned.handle("clearance").disabled


def test_a_parameter_is_named_for_people():
    assert label("weights.position") == "position weight"
    assert label("safety.least_clearance") == "least clearance"


@pytest.mark.parametrize(
    ("value", "expected"), [(600.0, 20.0), (0.05, 0.002), (1.0, 0.05), (0.0, 0.01), (20.0, 1.0)]
)
def test_a_step_is_a_round_share_of_the_value(value, expected):
    assert step(value) == pytest.approx(expected)
