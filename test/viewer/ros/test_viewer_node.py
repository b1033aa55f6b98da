"""Tests of the viewer node over its topics, with a fake page."""

import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped

from omniman_ros import extras
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.viewer import node as viewer
from omniman_ros.viewer.events import (
    ButtonHeld,
    ButtonPressed,
    ButtonReleased,
    ClientDisconnected,
    GoalDragged,
    ObstacleVelocitySet,
)
from omniman_ros.viewer.hold_to_drive import DEAD_MAN_TIMEOUT
from test.nodes.harness import last
from test.viewer.ros.fake_page import Services, post, press, until, view

HEARTBEAT = 0.05


@pytest.fixture
def world():
    with view() as made:
        made.run(0.1)
        yield made


def hold(world, motion="forward", seconds=1.0, client=1):
    """Hold a button as a page does."""
    page = world.nodes[-1].page
    for _ in range(round(seconds / HEARTBEAT)):
        page.post(ButtonHeld(client, motion))
        world.run(HEARTBEAT)


def components(messages):
    return [(m.linear.x, m.linear.y, m.angular.z) for m in messages]


# ---- driving ----------------------------------------------------------------------------------


def test_a_held_button_is_a_stream_of_twists_after_a_zero(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 1.0)
    asked = components(twists)
    assert asked[0] == (0.0, 0.0, 0.0)
    assert set(asked[1:]) == {(0.4, 0.0, 0.0)}
    assert 18 <= len(asked) <= 21, "20 a second"


def test_a_release_is_followed_by_zeros_and_then_by_silence(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "turn_left", 0.5)
    assert components(twists)[-1] == (0.0, 0.0, 0.8)
    world.nodes[0].page.post(ButtonReleased(1, "turn_left"))
    world.run_until(lambda: components(twists)[-1] == (0.0, 0.0, 0.0), 0.1, "a zero at once")
    stopped = len(twists)
    world.run(1.0)
    assert set(components(twists[stopped:])) == {(0.0, 0.0, 0.0)}
    assert len(twists) - stopped < 10
    silent = len(twists)
    world.run(1.0)
    assert len(twists) == silent


@pytest.mark.parametrize(
    ("lost", "within"),
    [(None, 0.3), (ClientDisconnected(1), 0.1)],
    ids=["stalled", "disconnected"],
)
def test_a_stalled_or_disconnected_page_stops_the_robot(world, lost, within):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "back", 0.5)
    if lost:
        world.nodes[0].page.post(lost)
    assert components(twists)[-1] == (-0.4, 0.0, 0.0)
    took = world.run_until(lambda: components(twists)[-1] == (0.0, 0.0, 0.0), within, "a zero")
    assert lost or took > DEAD_MAN_TIMEOUT - 2 * HEARTBEAT


def test_buttons_held_while_the_node_was_suspended_do_not_drive(world):
    twists = world.listen(Twist, "cmd_vel")
    world.run(0.2)
    for _ in range(20):
        world.nodes[0].page.post(ButtonHeld(1, "forward"))
    world.time += 1.0  # without any timer callback
    world.run(0.5)
    assert components(twists) == []


def test_buttons_held_before_time_went_back_do_not_drive(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    world.time -= 500.0
    world.run(0.5)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)


def test_a_stamped_controller_gets_stamped_twists():
    with view(parameters={"cmd_vel_stamped": True}) as world:
        twists = world.listen(TwistStamped, "cmd_vel")
        hold(world, "left", 0.3)
        message = last(twists)
        assert message.header.frame_id == "base_link"
        assert message.header.stamp.sec == int(world.time)
        assert components([message.twist]) == [(0.0, 0.4, 0.0)]


def test_a_shutdown_sends_zeros_even_while_a_button_is_held(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    node = world.nodes[0]
    node.begin_shutdown("SIGINT")
    world.run_until(lambda: node.finished, node.stop_timeout, "zeros")
    hold(world, "forward", 0.2)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)
    assert node.finished


def test_the_page_receives_the_limits_and_is_served_to_this_machine_alone():
    with view(parameters={"robot": "ig42", "port": 9000}) as world:
        constraints, limits, host, port = world.nodes[0].page.made_with
        assert (constraints, limits, host, port) == (1, (1.0, 2.0), "127.0.0.1", 9000)


@pytest.mark.parametrize(("robot", "armed"), [("omniman", True), ("ig42", False)])
def test_the_page_shows_an_arm_only_if_the_robot_has_one(robot, armed):
    with view(parameters={"robot": robot}) as world:
        mount = world.nodes[0].page.mount
        assert (mount is not None) == armed
        assert mount is None or mount.z > 0.0


def test_an_unknown_button_is_refused(world):
    press(world, "self_destruct", 0.1)
    assert world.nodes[0].state.note == "there is no button 'self_destruct'"


def test_the_page_ends_with_the_node():
    with view() as world:
        page = world.nodes[0].page
    assert page.closed


# ---- the other buttons ------------------------------------------------------------------------


def test_stop_and_reset_reach_every_node_that_moves_the_robot():
    with view(PlatformControllerNode) as world:
        states = world.listen(DiagnosticStatus, "stop_state", LATCHED)
        state = world.nodes[-1].state
        world._await(lambda: displays(world, state, "running"), "the state on the page")
        press(world, "stop")
        assert last(states).message == "stopped: ~/stop"
        assert state.note == "stop: platform_controller done"
        assert displays(world, state, "stopped: ~/stop")
        press(world, "reset")
        assert last(states).message == "running"
        assert displays(world, state, "running")
        assert state.note == "reset: platform_controller done"


def displays(world, state, text):
    world.run(0.05)
    return [condition.text for condition in state.stops.values()] == [text]


def test_a_reset_ends_the_search_for_nodes_to_stop(world):
    """Otherwise a node that is found after the reset would be stopped."""
    press(world, "stop")
    press(world, "reset")
    world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    services = Services(world, "probe", "stop", "reset")
    until(world, lambda: services.called, "the reset")
    world.run(1.0)
    assert services.called == ["reset"]


def test_a_refused_reset_is_reported_with_its_reason(world):
    world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    services = Services(world, "probe", "reset", refuses="reset")
    state = world.nodes[0].state
    press(world, "reset", 0.0)
    until(world, lambda: services.called, "the call")
    world.run(0.2)
    assert services.called == ["reset"]
    assert state.note == "reset: probe REFUSED (not now)"


def test_stop_releases_a_held_button(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    press(world, "stop", 0.06)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)


def test_a_stop_without_a_robot_reports_that_no_node_is_found(world):
    press(world, "stop", 6.0)
    assert world.nodes[0].state.note == "stop: no node found yet"


@pytest.mark.parametrize("action", ["pause", "resume", "cancel"])
def test_path_and_planner_services_are_called_together(world, action):
    state = world.nodes[0].state
    press(world, action)
    assert state.note == f"{action}: no path_interpolator or whole_body_planner or mpc_planner"
    assert state.services == frozenset()
    path = Services(world, "path_interpolator", action)
    names = {f"path_interpolator/{action}"}
    until(world, lambda: state.services == names, "the service")
    press(world, action)
    until(world, lambda: state.note == f"{action}: path_interpolator done", "the answer")
    planner = Services(world, "mpc_planner", action)
    until(world, lambda: state.services == names | {f"mpc_planner/{action}"}, "the other")
    press(world, action)
    both = f"{action}: path_interpolator done, mpc_planner done"
    until(world, lambda: state.note == both, "both answers")
    assert (path.called, planner.called) == ([action] * 2, [action])


def test_the_refusal_of_an_idle_planner_is_not_reported(world):
    state = world.nodes[0].state
    Services(world, "path_interpolator", "pause")
    Services(world, "mpc_planner", "pause", refuses="pause", why="nothing to pause: idle")
    report = world.publisher(DiagnosticStatus, "mpc/status")
    report.publish(DiagnosticStatus(values=[KeyValue(key="state", value="idle")]))
    until(world, lambda: state.planner, "the status")
    until(world, lambda: len(state.services) == 2, "the services")
    press(world, "pause")
    until(world, lambda: state.note == "pause: path_interpolator done", "the answers")


def test_the_refusal_of_an_idle_path_interpolator_is_not_reported(world):
    state = world.nodes[0].state
    Services(world, "path_interpolator", "pause", refuses="pause", why="no path to pause: idle")
    Services(world, "mpc_planner", "pause")
    values = [KeyValue(key=key, value="idle") for key in ("state", "arm", "body")]
    status = DiagnosticStatus(name="/path_interpolator", values=values)
    world.publisher(DiagnosticArray, "/diagnostics").publish(DiagnosticArray(status=[status]))
    until(world, lambda: state.path_states == {"path_interpolator": {"idle"}}, "the diagnostics")
    until(world, lambda: len(state.services) == 2, "the services")
    press(world, "pause")
    until(world, lambda: state.note == "pause: mpc_planner done", "the answers")


def test_a_refusal_is_reported_with_its_reason(world):
    state = world.nodes[0].state
    Services(world, "mpc_planner", "resume", refuses="resume")
    until(world, lambda: state.services == {"mpc_planner/resume"}, "the service")
    press(world, "resume")
    until(world, lambda: state.note == "resume: mpc_planner REFUSED (not now)", "the answer")


def test_an_answer_is_awaited_for_four_seconds(world):
    state = world.nodes[0].state
    Services(world, "mpc_planner", "cancel")
    until(world, lambda: state.services == {"mpc_planner/cancel"}, "the service")
    world.executor.remove_node(world.probe)  # it receives the call, but never answers
    press(world, "cancel", 3.9)
    assert state.note == "cancel: mpc_planner ..."
    world.run(0.3)
    assert state.note == "cancel: mpc_planner does not answer"
    world.executor.add_node(world.probe)


def test_trails_are_cleared(world):
    state = world.nodes[0].state
    state.odom_trail.add(1.0, 1.0)
    press(world, "clear", 0.1)
    assert len(state.odom_trail.points) == 0


# ---- without viser ----------------------------------------------------------------------------


def test_without_viser_the_node_exits_with_the_install_command(monkeypatch, capsys):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert viewer.main() == 1
    assert "pip install 'viser" in capsys.readouterr().err


def test_the_module_can_be_imported_without_viser():
    """Other nodes look up its parameters."""
    code = (
        "import sys; sys.modules['viser'] = None; "
        "from omniman_ros.nodes.registry import node_specs; "
        "assert any(spec.name == 'frame_rate' for spec in node_specs('viewer'))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


# ---- the tour ---------------------------------------------------------------------------------


def test_the_tour_goes_on_with_what_is_done_on_the_page(world):
    state = world.nodes[-1].state
    world.run(0.1)
    assert state.tour.startswith("1 of 6")
    post(world, ButtonHeld(1, "forward"))
    assert state.tour.startswith("2 of 6")
    press(world, "tour")
    assert state.tour == "", "it was ended"
    press(world, "tour")
    assert state.tour.startswith("1 of 6")
    post(world, ButtonPressed("stop"))
    post(world, ButtonHeld(1, "forward"), GoalDragged((1.0, 0.0, 0.0), True))
    assert state.tour.startswith("4 of 6")
    press(world, "add")
    post(world, ObstacleVelocitySet(99, (0.1, 0.0)))
    assert state.tour.startswith("5 of 6"), "what is refused does not count"
