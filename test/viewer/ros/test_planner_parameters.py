"""The planner's parameters on the page, with the real planner."""

import math

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from omniman_ros.nodes.mpc_planner.node import MpcPlannerNode
from omniman_ros.viewer.events import ParameterChanged
from omniman_ros.viewer.ros.planner_parameters import PARAMETER_NAMES
from test.viewer.ros.fake_page import post, until, view


@pytest.fixture(scope="module")
def shared_world():
    with view(MpcPlannerNode, parameters={"horizon.steps": 5}) as world:
        yield world


@pytest.fixture
def world(shared_world):
    state = shared_world.nodes[-1].state
    until(
        shared_world,
        lambda: len(state.planner_parameters) == len(PARAMETER_NAMES),
        "the parameters",
        0.5,
    )
    state.note = ""
    return shared_world


def core(world):
    """Return values of the planner's parameters."""
    return world.nodes[0].settings.value.core


def value(world, name):
    return world.nodes[-1].state.planner_parameters[name].value


def set_by_others(world, name, number):
    request = SetParameters.Request(parameters=[Parameter(name, value=number).to_parameter_msg()])
    assert world.call(SetParameters, "mpc_planner/set_parameters", request).results[0].successful


def test_parameters_are_shown_as_the_planner_has_them(world):
    parameters = world.nodes[-1].state.planner_parameters
    assert tuple(parameters) == PARAMETER_NAMES
    shown = parameters["weights.position"]
    assert (shown.value, shown.low, shown.high) == (core(world).weights.position, 0.0, 1e6)
    assert "Weight W_pos" in shown.text
    assert parameters["safety.berth"].high == 5.0


def test_a_set_value_arrives_at_the_planner(world):
    post(world, ParameterChanged("weights.position", 321.0))
    until(world, lambda: value(world, "weights.position") == 321.0, "the answer")
    assert core(world).weights.position == 321.0


def test_the_last_of_many_successive_values_is_set(world):
    for k in range(50):
        post(world, ParameterChanged("weights.heading", 100.0 + k), seconds=0.01)
    until(world, lambda: core(world).weights.heading == 149.0, "the last")
    world.run(0.5)
    assert core(world).weights.heading == 149.0
    until(world, lambda: value(world, "weights.heading") == 149.0, "the answer")


def test_a_refused_value_is_reported_with_its_reason_and_not_displayed(world):
    before = value(world, "safety.clearance")
    post(world, ParameterChanged("safety.clearance", 0.0))
    until(world, lambda: "REFUSED" in world.nodes[-1].state.note, "the refusal")
    note = world.nodes[-1].state.note
    assert note.startswith("safety.clearance REFUSED (") and "safety.least_clearance" in note
    assert value(world, "safety.clearance") == before == core(world).safety.clearance


def test_a_value_out_of_range_is_refused_by_the_planner(world):
    post(world, ParameterChanged("weights.energy", 1e5))
    until(world, lambda: "weights.energy REFUSED" in world.nodes[-1].state.note, "the refusal")
    assert core(world).weights.energy < 1e5


@pytest.mark.parametrize(
    "bad",
    [
        ParameterChanged("weights.position", math.nan),
        ParameterChanged("weights.position", math.inf),
        ParameterChanged("odom_timeout", 0.1),
        ParameterChanged("weights.beauty", 1.0),
    ],
    ids=str,
)
def test_an_invalid_value_is_refused_by_the_viewer(world, bad):
    asked = []
    client = world.nodes[-1]._planner_parameters._client
    send, client.set_parameters = client.set_parameters, asked.append
    post(world, bad, seconds=0.3)
    client.set_parameters = send
    assert world.nodes[-1].state.note and asked == []


def test_a_value_set_by_another_node_is_displayed(world):
    set_by_others(world, "safety.berth", 1.25)
    until(world, lambda: value(world, "safety.berth") == 1.25, "the change")


def test_the_workspace_is_shown_and_followed(world):
    state = world.nodes[-1].state
    assert state.workspace[2:] == (1000.0, 1000.0)
    set_by_others(world, "workspace.x_min", -3.5)
    until(world, lambda: state.workspace[0] == -3.5, "the change")
    assert state.workspace[1:] == (-1000.0, 1000.0, 1000.0)


def test_parameters_disappear_with_the_planner_and_return_with_the_next_one(world):
    """This test comes last: it ends the planner that all tests here share."""
    state = world.nodes[-1].state
    set_by_others(world, "weights.running", 3.0)
    until(world, lambda: value(world, "weights.running") == 3.0, "the change")
    planner = world.nodes.pop(0)
    world.executor.remove_node(planner)
    planner.destroy_node()
    until(
        world, lambda: state.planner_parameters == {} and state.workspace is None, "its end", 0.5
    )
    post(world, ParameterChanged("weights.running", 2.0))
    assert "cannot be set" in state.note
    overrides = [Parameter("use_sim_time", value=True), Parameter("horizon.steps", value=5)]
    world.nodes.insert(0, MpcPlannerNode(context=world.context, parameter_overrides=overrides))
    world.executor.add_node(world.nodes[0])
    until(
        world, lambda: len(state.planner_parameters) == len(PARAMETER_NAMES), "the next one", 0.5
    )
    assert value(world, "weights.running") == 1.0
