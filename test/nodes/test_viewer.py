"""The viewer's node over its topics, with a page that a test presses."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.nodes import viewer
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.stopping import LATCHED
from omniman_ros.nodes.viewer import ViewerNode
from omniman_ros.viewer.hold import DEAD_MAN, Gone, Held, Pressed, Released

from .harness import World, last
from .rig import reference

NAMES = ["front_left", "front_right", "rear_left", "rear_right"]
HEARTBEAT = 0.05


class FakePage:
    """What the node sees of a page."""

    def __init__(self, robot, constraints, limits, host, port, post):
        self.made_with = (constraints, limits, host, port)
        self.address = f"http://{host}:{port}"
        self.post = post
        self.speeds = (0.4, 0.8)
        self.watched = True
        self.frames = []
        self.closed = False

    def draw(self, picture, now):
        self.frames.append(now)

    def close(self):
        self.closed = True


def view(*others, parameters=None):
    """A world with the viewer, and perhaps other nodes."""
    return World(*others, partial(ViewerNode, make_page=FakePage), parameters=parameters)


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


def test_the_page_ends_with_the_node():
    with view() as world:
        page = world.nodes[0].page
    assert page.closed


# ---- the other buttons ------------------------------------------------------------------------


class Services:
    """Trigger services of a node, and what was called."""

    def __init__(self, world, node, *actions, refuses=""):
        self.called = []
        for action in actions:
            world.probe.create_service(Trigger, f"{node}/{action}", self._answer(action, refuses))

    def _answer(self, action, refuses):
        def answer(request, response):
            self.called.append(action)
            response.success = action != refuses
            response.message = "not now" if action == refuses else ""
            return response

        return answer


def press(world, action, seconds=0.5):
    world.nodes[-1].page.post(Pressed(action))
    world.run(seconds)


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
    world._await(lambda: (world.run(0.05), services.called)[1], "the reset")
    world.run(1.0)
    assert services.called == ["reset"]


def test_a_refused_reset_is_told_with_its_reason(world):
    world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    services = Services(world, "probe", "reset", refuses="reset")
    picture = world.nodes[0].picture
    press(world, "reset", 0.0)
    world._await(lambda: (world.run(0.05), services.called)[1], "the call")
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
def test_a_path_button_calls_the_interpolator(world, action):
    picture = world.nodes[0].picture
    press(world, action)
    assert picture.note == f"path_interpolator/{action} is not there"
    assert picture.services == frozenset()
    services = Services(world, "path_interpolator", action)
    name = f"path_interpolator/{action}"
    world._await(lambda: (world.run(0.5), name in picture.services)[1], "the service")
    press(world, action)
    world._await(lambda: (world.run(0.05), picture.note == f"{name} done")[1], "the answer")
    assert services.called == [action]


def test_trails_are_cleared(world):
    picture = world.nodes[0].picture
    picture.odom_trail.add(1.0, 1.0)
    press(world, "clear", 0.1)
    assert len(picture.odom_trail.points) == 0


# ---- the picture ------------------------------------------------------------------------------


def test_frames_are_drawn_while_somebody_looks_only(world):
    page = world.nodes[0].page
    before = len(page.frames)
    world.run(1.0)
    assert len(page.frames) - before == pytest.approx(25, abs=1)
    page.watched = False
    before = len(page.frames)
    world.run(1.0)
    assert len(page.frames) == before


def test_fast_topics_are_heard_while_somebody_looks_only(world):
    page = world.nodes[0].page

    def subscribers(count):
        world.run(0.05)
        return world.probe.count_subscribers("wheel_states") == count

    world._await(lambda: subscribers(1), "the viewer")
    page.watched = False
    world._await(lambda: subscribers(0), "its silence")
    page.watched = True
    world._await(lambda: subscribers(1), "the viewer again")
    states = world.publisher(JointState, "wheel_states")
    states.publish(wheel_state([1.0, 2.0, 3.0, 4.0]))
    angles = world.nodes[0].picture
    world._await(lambda: (world.run(0.05), angles.wheel_angles[3] == 4.0)[1], "the wheels")


def wheel_state(angles, names=NAMES):
    return JointState(name=names, position=angles, velocity=[0.1 * angle for angle in angles])


def test_wheels_are_told_by_name(world):
    states = world.publisher(JointState, "wheel_states")
    commands = world.publisher(JointState, "wheel_commands")
    states.publish(wheel_state([4.0, 3.0, 2.0, 1.0], NAMES[::-1]))
    commands.publish(JointState(name=NAMES, velocity=[5.0, 6.0, 7.0, 8.0], effort=[0.0] * 4))
    picture = world.nodes[0].picture
    world.run_until(lambda: picture.wheel_angles[0] == 1.0, 1.0, "the wheels")
    world.run(0.1)
    _, *speeds = picture.wheel_speeds.columns(world.time)
    assert [s[-1] for s in speeds] == pytest.approx([0.1, 0.2, 0.3, 0.4, 5.0, 6.0, 7.0, 8.0])


@pytest.mark.parametrize(
    "bad",
    [wheel_state([1.0, 2.0, 3.0], NAMES[:3]), wheel_state([float("nan")] * 4),
     JointState(name=NAMES, position=[1.0])],
)  # fmt: skip
def test_nonsense_of_the_wheels_is_not_shown(world, bad):
    states = world.publisher(JointState, "wheel_states")
    states.publish(bad)
    world.run(0.2)
    assert not world.nodes[0].picture.wheel_angles.any()
    assert "wheel_states" in world.nodes[0]._throttle.counts


def odometry(x, y, heading):
    message = Odometry()
    message.header.frame_id = "odom"
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = float(np.sin(heading / 2))
    message.pose.pose.orientation.w = float(np.cos(heading / 2))
    return message


def test_odometry_and_truth_are_drawn_with_their_trails(world):
    odom = world.publisher(Odometry, "odom")
    truth = world.publisher(Odometry, "ground_truth/odom")
    picture = world.nodes[0].picture
    for i in range(10):
        odom.publish(odometry(0.1 * i, 0.0, 0.5))
        truth.publish(odometry(0.1 * i, 0.01, 0.5))
        world.run(0.1)
    assert picture.odom == pytest.approx((0.9, 0.0, 0.5))
    assert picture.truth == pytest.approx((0.9, 0.01, 0.5))
    assert picture.odom_trail.points[:, 0] == pytest.approx(0.1 * np.arange(10))
    assert picture.truth_trail.points[:, 1] == pytest.approx(0.01)


def path(count, frame="odom"):
    message = Path()
    message.header.frame_id = frame
    for i in range(count):
        pose = PoseStamped()
        pose.pose.position.x = 0.001 * i
        message.poses.append(pose)
    return message


def test_a_path_is_drawn_thinned_to_its_ends(world):
    paths = world.publisher(Path, "path")
    paths.publish(path(5000))
    line = world.nodes[0].picture.path
    world.run_until(lambda: line.version > 0, 1.0, "the path")
    assert len(line.points) == 1000
    assert line.points[-1].tolist() == pytest.approx([4.999, 0.0])


def test_an_empty_path_clears_the_line(world):
    paths = world.publisher(Path, "path")
    paths.publish(path(5))
    paths.publish(path(0))
    line = world.nodes[0].picture.path
    world.run_until(lambda: line.version == 2, 1.0, "both")
    assert line.points.shape == (0, 2)


def test_a_path_in_map_is_drawn_where_the_two_are_one():
    with view(parameters={"map_is_odom": True}) as world:
        world.publisher(Path, "path").publish(path(5, "map"))
        line = world.nodes[0].picture.path
        world.run_until(lambda: line.version == 1, 1.0, "the path")


def test_a_path_in_another_frame_is_not_drawn_as_if_it_were_here(world):
    world.publisher(Path, "path").publish(path(5, "elsewhere"))
    world.run(0.2)
    assert world.nodes[0].picture.path.version == 0
    assert "path" in world.nodes[0]._throttle.counts


def test_the_plan_is_drawn_and_goes_when_it_is_over(world):
    world.publisher(Path, "mpc/plan").publish(path(5))
    line = world.nodes[0].picture.plan
    world.run_until(lambda: len(line.points) == 5, 1.0, "the plan")
    world.run_until(lambda: len(line.points) == 0, 2.0, "its end")


def marker(**changes):
    result = Marker(type=Marker.CYLINDER, **changes)
    result.header.frame_id = "odom"
    result.scale.x = result.scale.y = 0.6
    result.pose.orientation.w = 1.0
    return result


def test_obstacles_are_outlined_until_they_are_deleted(world):
    obstacles, line = world.publisher(MarkerArray, "obstacles"), world.nodes[0].picture.obstacles
    obstacles.publish(MarkerArray(markers=[marker(id=1), marker(id=2)]))
    world.run_until(lambda: len(line.points) > 0, 1.0, "the obstacles")
    around = line.points[np.isfinite(line.points).all(axis=1)]
    assert np.hypot(*around.T) == pytest.approx(0.3, abs=1e-6)
    obstacles.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
    world.run_until(lambda: len(line.points) == 0, 1.0, "nothing")


def test_a_bad_obstacle_is_warned_of_and_the_others_are_drawn(world):
    bad = marker(id=1)
    bad.scale.x = 0.0
    world.publisher(MarkerArray, "obstacles").publish(MarkerArray(markers=[bad, marker(id=2)]))
    line = world.nodes[0].picture.obstacles
    world.run_until(lambda: len(line.points) > 0, 1.0, "the good one")
    assert world.nodes[0]._throttle.counts


def test_the_reference_and_the_progress_are_shown(world):
    references = world.publisher(MultiDOFJointTrajectory, "path/reference")
    progress = world.publisher(Float64, "path_progress")
    references.publish(
        reference([0.0, 0.1], [(1.0, 2.0, 0.0), (1.1, 2.0, 0.0)], [(1, 0, 0)] * 2, world.stamp())
    )
    progress.publish(Float64(data=0.3))
    picture = world.nodes[0].picture
    world.run_until(lambda: picture.progress == 0.3, 1.0, "the progress")
    assert picture.reference.points.tolist() == [[1.0, 2.0], [1.1, 2.0]]
    progress.publish(Float64(data=7.0))
    world.run(0.2)
    assert picture.progress == 0.3


def test_only_the_last_of_a_stream_is_converted(world):
    """200 messages a second, 25 frames."""
    states = world.publisher(JointState, "wheel_states")
    heard = []
    node = world.nodes[0]
    hear = node.picture.hear_wheels
    node.picture.hear_wheels = lambda *given: (heard.append(given), hear(*given))
    world.run(1.0, lambda: states.publish(wheel_state([world.time] * 4)))
    assert 20 <= len(heard) <= 50
    assert node.picture.wheel_angles[0] == pytest.approx(world.time, abs=0.05)


def test_what_other_nodes_warn_of_is_shown_in_the_viewers_namespace_only():
    with World(
        partial(ViewerNode, make_page=FakePage, namespace="robot1"),
    ) as world:
        diagnostics = world.publisher(DiagnosticArray, "/diagnostics")
        diagnostics.publish(
            DiagnosticArray(
                status=[
                    DiagnosticStatus(name="/robot1/a", level=b"\x01", message="a wheel is dead"),
                    DiagnosticStatus(name="/robot1/b", level=b"\x00", message="running"),
                    DiagnosticStatus(name="/robot1/viewer", level=b"\x01", message="me"),
                    DiagnosticStatus(name="/robot2/a", level=b"\x02", message="of another"),
                ]
            )
        )
        picture = world.nodes[0].picture
        world.run(0.2)
        shown = {name: (c.level, c.text) for name, c in picture.complaints.items()}
        assert shown == {"/robot1/a": (1, "a wheel is dead")}


def test_a_node_that_vanished_is_marked(world):
    picture = world.nodes[0].picture
    states = world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    states.publish(DiagnosticStatus(name="/probe", level=b"\x02", message="stopped: x"))
    world._await(lambda: (world.run(0.05), picture.stops)[1], "the state")
    world.run(1.1)
    assert picture.stops["/probe"].text == "stopped: x"
    world.probe.destroy_publisher(states)
    world._await(lambda: (world.run(1.0), picture.stops["/probe"].text == "gone")[1], "the survey")
    assert picture.stops["/probe"].level == 2


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
