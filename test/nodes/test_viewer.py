"""The viewer's node over its topics, with a page that a test presses."""

import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped

from omniman_ros.nodes import viewer
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.stopping import LATCHED
from omniman_ros.viewer.events import Gone, Held, Released
from omniman_ros.viewer.hold import DEAD_MAN

from .fake_page import Services, press, until, view
from .harness import last

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
        page.post(Held(client, motion))
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
    world.nodes[0].page.post(Released(1, "turn_left"))
    world.run_until(lambda: components(twists)[-1] == (0.0, 0.0, 0.0), 0.1, "a zero at once")
    stopped = len(twists)
    world.run(1.0)
    assert set(components(twists[stopped:])) == {(0.0, 0.0, 0.0)}
    assert len(twists) - stopped < 10
    silent = len(twists)
    world.run(1.0)
    assert len(twists) == silent


@pytest.mark.parametrize(
    ("lost", "within"), [(None, 0.3), (Gone(1), 0.1)], ids=["stalled", "disconnected"]
)
def test_a_page_that_stalls_or_is_lost_stops_the_robot(world, lost, within):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "back", 0.5)
    if lost:
        world.nodes[0].page.post(lost)
    assert components(twists)[-1] == (-0.4, 0.0, 0.0)
    took = world.run_until(lambda: components(twists)[-1] == (0.0, 0.0, 0.0), within, "a zero")
    assert lost or took > DEAD_MAN - 2 * HEARTBEAT


def test_what_was_held_while_the_node_could_not_listen_is_not_driven(world):
    twists = world.listen(Twist, "cmd_vel")
    world.run(0.2)
    for _ in range(20):
        world.nodes[0].page.post(Held(1, "forward"))
    world.time += 1.0  # no timer ran meanwhile
    world.run(0.5)
    assert components(twists) == []


def test_what_was_held_before_time_went_back_is_not_driven(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    world.time -= 500.0
    world.run(0.5)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)


def test_what_was_heard_before_time_went_back_is_not_fresh(world):
    picture = world.nodes[0].picture
    picture.hear_truth((0.0, 0.0, 0.0), world.nodes[0].now())
    world.run(0.2)
    world.time -= 500.0
    world.run(0.2)
    assert not picture.is_fresh("truth", world.nodes[0].now())


def test_without_a_button_nothing_is_sent(world):
    twists = world.listen(Twist, "cmd_vel")
    world.run(2.0)
    assert twists == []


def test_a_stamped_controller_gets_stamped_twists():
    with view(parameters={"cmd_vel_stamped": True}) as world:
        twists = world.listen(TwistStamped, "cmd_vel")
        hold(world, "left", 0.3)
        message = last(twists)
        assert message.header.frame_id == "base_link"
        assert message.header.stamp.sec == int(world.time)
        assert components([message.twist]) == [(0.0, 0.4, 0.0)]


def test_the_end_of_the_node_sends_zeros_whatever_is_held(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    node = world.nodes[0]
    node.begin_shutdown("SIGINT")
    world.run_until(lambda: node.finished, node.patience, "zeros")
    hold(world, "forward", 0.2)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)
    assert node.finished


def test_the_page_knows_the_limits_and_is_on_this_machine_alone():
    with view(parameters={"robot": "ig42", "port": 9000}) as world:
        constraints, limits, host, port = world.nodes[0].page.made_with
        assert (constraints, limits, host, port) == (1, (1.0, 2.0), "127.0.0.1", 9000)


@pytest.mark.parametrize(("robot", "armed"), [("omniman", True), ("ig42", False)])
def test_the_page_knows_whether_there_is_an_arm(robot, armed):
    with view(parameters={"robot": robot}) as world:
        mount = world.nodes[0].page.mount
        assert (mount is not None) == armed
        assert mount is None or mount.z > 0.0


def test_a_button_that_nobody_knows_is_refused(world):
    press(world, "self_destruct", 0.1)
    assert world.nodes[0].picture.note == "there is no button 'self_destruct'"


def test_the_page_ends_with_the_node():
    with view() as world:
        page = world.nodes[0].page
    assert page.closed


# ---- the other buttons ------------------------------------------------------------------------


def test_stop_and_reset_reach_every_node_that_moves_something():
    with view(PlatformControllerNode) as world:
        states = world.listen(DiagnosticStatus, "stop_state", LATCHED)
        picture = world.nodes[-1].picture
        world._await(lambda: seen(world, picture, "running"), "the state on the page")
        press(world, "stop")
        assert last(states).message == "stopped: ~/stop"
        assert picture.note == "stop: platform_controller done"
        assert seen(world, picture, "stopped: ~/stop")
        press(world, "reset")
        assert last(states).message == "running"
        assert seen(world, picture, "running")
        assert picture.note == "reset: platform_controller done"


def seen(world, picture, text):
    world.run(0.05)
    return [condition.text for condition in picture.stops.values()] == [text]


def test_a_reset_ends_the_search_for_nodes_to_stop(world):
    """A node that turns up after the reset would be stopped else."""
    press(world, "stop")
    press(world, "reset")
    world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    services = Services(world, "probe", "stop", "reset")
    until(world, lambda: services.called, "the reset")
    world.run(1.0)
    assert services.called == ["reset"]


def test_a_refused_reset_is_told_with_its_reason(world):
    world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    services = Services(world, "probe", "reset", refuses="reset")
    picture = world.nodes[0].picture
    press(world, "reset", 0.0)
    until(world, lambda: services.called, "the call")
    world.run(0.2)
    assert services.called == ["reset"]
    assert picture.note == "reset: probe REFUSED (not now)"


def test_stop_lets_go_of_a_held_button(world):
    twists = world.listen(Twist, "cmd_vel")
    hold(world, "forward", 0.5)
    press(world, "stop", 0.06)
    assert components(twists)[-1] == (0.0, 0.0, 0.0)


def test_a_stop_without_a_robot_says_that_there_is_none(world):
    press(world, "stop", 6.0)
    assert world.nodes[0].picture.note == "stop: no node found yet"


@pytest.mark.parametrize("action", ["pause", "resume", "cancel"])
def test_path_and_planner_are_asked_together(world, action):
    picture = world.nodes[0].picture
    press(world, action)
    assert picture.note == f"{action}: no path_interpolator and no mpc_planner"
    assert picture.services == frozenset()
    path = Services(world, "path_interpolator", action)
    names = {f"path_interpolator/{action}"}
    until(world, lambda: picture.services == names, "the service")
    press(world, action)
    until(world, lambda: picture.note == f"{action}: path_interpolator done", "the answer")
    planner = Services(world, "mpc_planner", action)
    until(world, lambda: picture.services == names | {f"mpc_planner/{action}"}, "the other")
    press(world, action)
    both = f"{action}: path_interpolator done, mpc_planner done"
    until(world, lambda: picture.note == both, "both answers")
    assert (path.called, planner.called) == ([action] * 2, [action])


def test_a_planner_with_nothing_to_pause_is_no_refusal(world):
    picture = world.nodes[0].picture
    Services(world, "path_interpolator", "pause")
    Services(world, "mpc_planner", "pause", refuses="pause", why="nothing to pause: idle")
    until(world, lambda: len(picture.services) == 2, "the services")
    press(world, "pause")
    until(world, lambda: picture.note == "pause: path_interpolator done", "the answers")


def test_a_refusal_is_told_with_its_reason(world):
    picture = world.nodes[0].picture
    Services(world, "mpc_planner", "resume", refuses="resume")
    until(world, lambda: picture.services == {"mpc_planner/resume"}, "the service")
    press(world, "resume")
    until(world, lambda: picture.note == "resume: mpc_planner REFUSED (not now)", "the answer")


def test_who_does_not_answer_is_waited_for_four_seconds(world):
    picture = world.nodes[0].picture
    Services(world, "mpc_planner", "cancel")
    until(world, lambda: picture.services == {"mpc_planner/cancel"}, "the service")
    world.executor.remove_node(world.probe)  # it hears, and says nothing
    press(world, "cancel", 3.9)
    assert picture.note == "cancel: mpc_planner ..."
    world.run(0.3)
    assert picture.note == "cancel: mpc_planner does not answer"
    world.executor.add_node(world.probe)


def test_trails_are_cleared(world):
    picture = world.nodes[0].picture
    picture.odom_trail.add(1.0, 1.0)
    press(world, "clear", 0.1)
    assert len(picture.odom_trail.points) == 0


# ---- without viser ----------------------------------------------------------------------------


def test_without_viser_it_ends_with_the_command_that_installs_it(monkeypatch, capsys):
    monkeypatch.setattr(viewer.availability, "find_spec", lambda name: None)
    assert viewer.main() == 1
    assert "pip install 'viser" in capsys.readouterr().err


def test_the_module_is_there_without_viser():
    """Other nodes look up its parameters."""
    code = (
        "import sys; sys.modules['viser'] = None; "
        "from omniman_ros.nodes.registry import node_specs; "
        "assert any(spec.name == 'frame_rate' for spec in node_specs('viewer'))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
