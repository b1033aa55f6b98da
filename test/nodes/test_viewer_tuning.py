"""The planner's parameters on the page, with the real planner."""

import math

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from omniman_ros.nodes.mpc_planner import MpcPlannerNode
from omniman_ros.nodes.viewing.tuning import TUNED
from omniman_ros.viewer.events import Tuned

from .fake_page import post, until, view


@pytest.fixture(scope="module")
def made():
    with view(MpcPlannerNode, parameters={"horizon.steps": 5}) as world:
        yield world


@pytest.fixture
def world(made):
    picture = made.nodes[-1].picture
    until(made, lambda: len(picture.tunables) == len(TUNED), "the parameters", 0.5)
    picture.note = ""
    return made


def core(world):
    """Parameters that the planner has."""
    return world.nodes[0].settings.value.core


def value(world, name):
    return world.nodes[-1].picture.tunables[name].value


def set_by_others(world, name, number):
    request = SetParameters.Request(parameters=[Parameter(name, value=number).to_parameter_msg()])
    assert world.call(SetParameters, "mpc_planner/set_parameters", request).results[0].successful


def test_parameters_are_shown_as_the_planner_has_them(world):
    tunables = world.nodes[-1].picture.tunables
    assert tuple(tunables) == TUNED
    shown = tunables["weights.position"]
    assert (shown.value, shown.low, shown.high) == (core(world).weights.position, 0.0, 1e6)
    assert "Weight W_pos" in shown.text
    assert tunables["safety.berth"].high == 5.0


def test_what_is_set_is_what_the_planner_has(world):
    post(world, Tuned("weights.position", 321.0))
    until(world, lambda: value(world, "weights.position") == 321.0, "the answer")
    assert core(world).weights.position == 321.0


def test_of_many_values_in_a_row_the_last_is_set(world):
    for k in range(50):
        post(world, Tuned("weights.heading", 100.0 + k), seconds=0.01)
    until(world, lambda: core(world).weights.heading == 149.0, "the last")
    world.run(0.5)
    assert core(world).weights.heading == 149.0
    until(world, lambda: value(world, "weights.heading") == 149.0, "the answer")


def test_a_refused_value_is_told_with_its_reason_and_not_shown(world):
    before = value(world, "safety.clearance")
    post(world, Tuned("safety.clearance", 0.0))
    until(world, lambda: "REFUSED" in world.nodes[-1].picture.note, "the refusal")
    note = world.nodes[-1].picture.note
    assert note.startswith("safety.clearance REFUSED (") and "safety.least_clearance" in note
    assert value(world, "safety.clearance") == before == core(world).safety.clearance


def test_a_value_out_of_range_is_refused_by_the_planner(world):
    post(world, Tuned("weights.energy", 1e5))
    until(world, lambda: "weights.energy REFUSED" in world.nodes[-1].picture.note, "the refusal")
    assert core(world).weights.energy < 1e5


@pytest.mark.parametrize(
    "bad", [Tuned("weights.position", math.nan), Tuned("weights.position", math.inf),
            Tuned("odom_timeout", 0.1), Tuned("weights.beauty", 1.0)], ids=str,
)  # fmt: skip
def test_nonsense_is_refused_here(world, bad):
    asked = []
    client = world.nodes[-1]._tuning._client
    send, client.set_parameters = client.set_parameters, asked.append
    post(world, bad, seconds=0.3)
    client.set_parameters = send
    assert world.nodes[-1].picture.note and asked == []


def test_what_others_set_is_shown(world):
    set_by_others(world, "safety.berth", 1.25)
    until(world, lambda: value(world, "safety.berth") == 1.25, "the change")


def test_the_workspace_is_shown_and_followed(world):
    picture = world.nodes[-1].picture
    assert picture.workspace[2:] == (1000.0, 1000.0)
    set_by_others(world, "workspace.x_min", -3.5)
    until(world, lambda: picture.workspace[0] == -3.5, "the change")
    assert picture.workspace[1:] == (-1000.0, 1000.0, 1000.0)


def test_parameters_go_with_the_planner_and_come_with_the_next_one(world):
    """The last test here: it ends the planner that they share."""
    picture = world.nodes[-1].picture
    set_by_others(world, "weights.running", 3.0)
    until(world, lambda: value(world, "weights.running") == 3.0, "the change")
    planner = world.nodes.pop(0)
    world.executor.remove_node(planner)
    planner.destroy_node()
    until(world, lambda: picture.tunables == {} and picture.workspace is None, "its end", 0.5)
    post(world, Tuned("weights.running", 2.0))
    assert "cannot be set" in picture.note
    overrides = [Parameter("use_sim_time", value=True), Parameter("horizon.steps", value=5)]
    world.nodes.insert(0, MpcPlannerNode(context=world.context, parameter_overrides=overrides))
    world.executor.add_node(world.nodes[0])
    until(world, lambda: len(picture.tunables) == len(TUNED), "the next one", 0.5)
    assert value(world, "weights.running") == 1.0
