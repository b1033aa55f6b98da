"""Tests of the topics of robot and planner as stored in the view state."""

from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.wheels import electrical_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.viewer.node import ViewerNode
from omniman_ros.viewer.perceived import FRESHNESS_TIMEOUT
from test.nodes.harness import World
from test.nodes.rig import reference
from test.viewer.ros.fake_page import FakePage, view

NAMES = ["front_left", "front_right", "rear_left", "rear_right"]


@pytest.fixture
def world():
    with view() as made:
        made.run(0.1)
        yield made


def latest(world, name):
    """Return the latest value of each curve of a plot."""
    _, *signals = world.nodes[-1].state.windows[name].columns(world.time)
    return [signal[-1] for signal in signals]


# ---- the state ------------------------------------------------------------------------------


def test_frames_are_drawn_only_while_a_browser_is_connected(world):
    page = world.nodes[0].page
    before = len(page.frames)
    world.run(1.0)
    assert len(page.frames) - before == pytest.approx(25, abs=1)
    page.watched = False
    before = len(page.frames)
    world.run(1.0)
    assert len(page.frames) == before


def test_fast_topics_are_subscribed_only_while_a_browser_is_connected(world):
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
    angles = world.nodes[0].state
    world._await(lambda: (world.run(0.05), angles.wheel_angles[3] == 4.0)[1], "the wheels")


def wheel_state(angles, names=NAMES):
    return JointState(name=names, position=angles, velocity=[0.1 * angle for angle in angles])


def test_wheels_are_matched_by_name(world):
    states = world.publisher(JointState, "wheel_states")
    commands = world.publisher(JointState, "wheel_commands")
    states.publish(wheel_state([4.0, 3.0, 2.0, 1.0], NAMES[::-1]))
    commands.publish(JointState(name=NAMES, velocity=[5.0, 6.0, 7.0, 8.0], effort=[0.0] * 4))
    state = world.nodes[0].state
    world.run_until(lambda: state.wheel_angles[0] == 1.0, 1.0, "the wheels")
    world.run(0.1)
    expected = [0.1, 0.2, 0.3, 0.4, 5.0, 6.0, 7.0, 8.0]
    assert latest(world, "speeds") == pytest.approx(expected)


@pytest.mark.parametrize(
    "bad",
    [
        wheel_state([1.0, 2.0, 3.0], NAMES[:3]),
        wheel_state([float("nan")] * 4),
        JointState(name=NAMES, position=[1.0]),
    ],
)
def test_invalid_wheel_states_are_not_shown(world, bad):
    states = world.publisher(JointState, "wheel_states")
    states.publish(bad)
    world.run(0.2)
    assert not world.nodes[0].state.wheel_angles.any()
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
    state = world.nodes[0].state
    for i in range(10):
        odom.publish(odometry(0.1 * i, 0.0, 0.5))
        truth.publish(odometry(0.1 * i, 0.01, 0.5))
        world.run(0.1)
    assert state.odom == pytest.approx((0.9, 0.0, 0.5))
    assert state.truth == pytest.approx((0.9, 0.01, 0.5))
    assert state.odom_trail.points[:, 0] == pytest.approx(0.1 * np.arange(10))
    assert state.truth_trail.points[:, 1] == pytest.approx(0.01)


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
    line = world.nodes[0].state.path
    world.run_until(lambda: line.version > 0, 1.0, "the path")
    assert len(line.points) == 1000
    assert line.points[-1].tolist() == pytest.approx([4.999, 0.0])


def test_an_empty_path_clears_the_line(world):
    paths = world.publisher(Path, "path")
    paths.publish(path(5))
    paths.publish(path(0))
    line = world.nodes[0].state.path
    world.run_until(lambda: line.version == 2, 1.0, "both")
    assert line.points.shape == (0, 2)


def test_a_path_in_map_is_drawn_if_map_equals_odom():
    with view(parameters={"map_is_odom": True}) as world:
        world.publisher(Path, "path").publish(path(5, "map"))
        line = world.nodes[0].state.path
        world.run_until(lambda: line.version == 1, 1.0, "the path")


def test_a_path_in_another_frame_is_not_drawn(world):
    world.publisher(Path, "path").publish(path(5, "elsewhere"))
    world.run(0.2)
    assert world.nodes[0].state.path.version == 0
    assert "path" in world.nodes[0]._throttle.counts
    assert "'elsewhere'" in world.nodes[0].state.unplaced["path"]


def marker(**changes):
    result = Marker(type=Marker.CYLINDER, **changes)
    result.header.frame_id = "odom"
    result.scale.x = result.scale.y = 0.6
    result.pose.orientation.w = 1.0
    return result


def test_obstacles_are_shown_until_they_are_deleted(world):
    obstacles, state = world.publisher(MarkerArray, "obstacles"), world.nodes[0].state
    obstacles.publish(MarkerArray(markers=[marker(id=1), marker(id=2)]))
    world.run_until(lambda: len(state.other_obstacles) == 2, 1.0, "the obstacles")
    assert state.other_obstacles.semi_axes.tolist() == [[0.3, 0.3]] * 2
    obstacles.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
    world.run_until(lambda: len(state.other_obstacles) == 0, 1.0, "nothing")


def test_an_invalid_obstacle_causes_a_warning_and_the_others_are_shown(world):
    bad = marker(id=1)
    bad.scale.x = 0.0
    world.publisher(MarkerArray, "obstacles").publish(MarkerArray(markers=[bad, marker(id=2)]))
    world.run_until(lambda: len(world.nodes[0].state.other_obstacles) == 1, 1.0, "the good one")
    assert world.nodes[0]._throttle.counts


def test_the_reference_and_the_progress_are_shown(world):
    references = world.publisher(MultiDOFJointTrajectory, "path/reference")
    progress = world.publisher(Float64, "path_progress")
    references.publish(
        reference([0.0, 0.1], [(1.0, 2.0, 0.0), (1.1, 2.0, 0.0)], [(1, 0, 0)] * 2, world.stamp())
    )
    progress.publish(Float64(data=0.3))
    state = world.nodes[0].state
    world.run_until(lambda: state.progress == 0.3, 1.0, "the progress")
    assert state.reference.points.tolist() == [[1.0, 2.0], [1.1, 2.0]]
    progress.publish(Float64(data=7.0))
    world.run(0.2)
    assert state.progress == 0.3


def test_only_the_latest_message_of_a_stream_is_converted(world):
    """The stream has 200 messages per second, the page 25 frames per second."""
    states = world.publisher(JointState, "wheel_states")
    received = []
    node = world.nodes[0]
    update_signal = node.state.update_wheels
    node.state.update_wheels = lambda *given: (received.append(given), update_signal(*given))
    world.run(1.0, lambda: states.publish(wheel_state([world.time] * 4)))
    assert 20 <= len(received) <= 50
    assert node.state.wheel_angles[0] == pytest.approx(world.time, abs=0.05)


def test_only_diagnostics_of_the_viewers_namespace_are_displayed():
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
        state = world.nodes[0].state
        world.run(0.2)
        shown = {name: (c.level, c.text) for name, c in state.diagnostics.items()}
        assert shown == {"/robot1/a": (1, "a wheel is dead")}


def clock_diagnostics(**values):
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticArray(status=[DiagnosticStatus(name="/simulated_drive", values=pairs)])


def test_the_pace_is_displayed_while_time_stands_and_nothing_else_is_due(world):
    """The diagnostics come on real time. The status is drawn at once, and when time goes on."""
    node = world.nodes[0]
    diagnostics = world.publisher(DiagnosticArray, "/diagnostics")
    diagnostics.publish(clock_diagnostics(real_time_factor="0.7", waiting_for=""))
    world._await(lambda: (world.serve(), node.state.pace == 0.7)[1], "the pace")
    assert node.page.statuses == []
    frames = len(node.page.frames)
    diagnostics.publish(clock_diagnostics(real_time_factor="0.7", waiting_for="/a /b"))
    world._await(lambda: (world.serve(), node.page.statuses)[1], "the status")
    diagnostics.publish(clock_diagnostics(real_time_factor="0.5", waiting_for=""))
    world._await(lambda: (world.serve(), len(node.page.statuses) == 2)[1], "the status")
    assert node.page.statuses == [(0.7, ("/a", "/b")), (0.5, ())]
    assert len(node.page.frames) == frames


@pytest.mark.parametrize("value", ["fast", ""])
def test_a_pace_that_is_no_number_is_ignored_with_a_warning(world, value):
    node = world.nodes[0]
    world.publisher(DiagnosticArray, "/diagnostics").publish(
        clock_diagnostics(real_time_factor=value)
    )
    world._await(lambda: (world.serve(), node.warning_counts)[1], "the warning")
    assert node.state.pace is None


def test_a_node_that_vanished_is_marked(world):
    state = world.nodes[0].state
    states = world.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
    states.publish(DiagnosticStatus(name="/probe", level=b"\x02", message="stopped: x"))
    world._await(lambda: (world.run(0.05), state.stops)[1], "the state")
    world.run(1.1)
    assert state.stops["/probe"].text == "stopped: x"
    world.probe.destroy_publisher(states)
    world._await(lambda: (world.run(1.0), state.stops["/probe"].text == "gone")[1], "the survey")
    assert state.stops["/probe"].level == 2


def electrical(*rows):
    return electrical_message(np.array(rows, dtype=float))


def test_voltages_are_plotted_and_energy_counts_from_the_first_message(world):
    meters = world.publisher(Float64MultiArray, "wheel_electrical")
    meters.publish(electrical(*[(24.0, 1.0, 100.0)] * 4))
    world.run_until(lambda: latest(world, "energy") == [0.0], 1.0, "the first")
    meters.publish(electrical(*[(volts, 1.0, 102.5) for volts in (1.0, 2.0, 3.0, np.nan)]))
    world.run_until(lambda: latest(world, "energy") == [10.0], 1.0, "the second")
    volts = latest(world, "voltages")
    assert volts[:3] == [1.0, 2.0, 3.0] and np.isnan(volts[3])


def test_a_restarted_energy_counter_continues_the_displayed_energy(world):
    meters = world.publisher(Float64MultiArray, "wheel_electrical")
    for energy in (100.0, 110.0):
        meters.publish(electrical(*[(24.0, 1.0, energy)] * 4))
        world.run(0.1)
    world.run(FRESHNESS_TIMEOUT)
    for energy in (0.0, 1.0):
        meters.publish(electrical(*[(24.0, 1.0, energy)] * 4))
        world.run(0.1)
    assert latest(world, "energy") == [44.0]


def arm_state(angles, names=UR_JOINTS):
    return JointState(name=list(names), position=[float(angle) for angle in angles])


def test_arm_joints_are_matched_by_name(world):
    arm, state = world.publisher(JointState, "arm/joint_states"), world.nodes[0].state
    arm.publish(arm_state(range(6), UR_JOINTS[::-1]))
    world.run_until(lambda: state.arm is not None, 1.0, "the arm")
    assert state.arm.tolist() == [5.0, 4.0, 3.0, 2.0, 1.0, 0.0]
    arm.publish(arm_state([np.nan] * 6))
    world.run(0.2)
    assert state.arm[0] == 5.0


def timing(intervals, ages=()):
    message = Float64MultiArray(data=[*intervals, *ages])
    for label, values in (("intervals", intervals), ("ages", ages)):
        message.layout.dim.append(
            MultiArrayDimension(label=label, size=len(values), stride=len(values))
        )
    return message


def test_the_mean_and_the_longest_interval_of_the_arm_count_over_all_messages(world):
    sent = world.publisher(Float64MultiArray, "arm/timing")
    world.run_until(lambda: np.isclose(world.time % 0.05, 0.01, atol=1e-6), 1.0, "a period")
    sent.publish(timing([0.008, 0.012], [0.5, 0.5]))
    sent.publish(timing([0.007], [0.9]))
    world.run(0.1)
    mean, longest = latest(world, "sending")
    assert longest == pytest.approx(12.0)
    assert mean == pytest.approx(9.0)


def test_a_tool_path_is_drawn_in_space(world):
    message = path(3)
    message.poses[2].pose.position.z = 0.7
    world.publisher(Path, "tool_path").publish(message)
    line = world.nodes[0].state.tool_path
    world.run_until(lambda: line.version > 0, 1.0, "the path")
    assert line.points.shape == (3, 3) and line.points[2, 2] == 0.7


def planner_status(**values):
    return DiagnosticStatus(
        message="so far",
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def test_the_planners_status_is_stored_and_its_solve_time_plotted(world):
    status, state = world.publisher(DiagnosticStatus, "mpc/status"), world.nodes[0].state
    status.publish(planner_status(state="driving", solve_ms=12.5, slack_m=0.004))
    world.run_until(lambda: bool(state.planner), 1.0, "the status")
    world.run(0.1)
    assert state.planner["state"] == "driving" and state.planner["message"] == "so far"
    assert latest(world, "solving") == [12.5, 4.0]


def test_numbers_too_large_for_a_plot_are_not_plotted(world):
    status, state = world.publisher(DiagnosticStatus, "mpc/status"), world.nodes[0].state
    status.publish(planner_status(state="driving", solve_ms=1e300, slack_m=1e307))
    world.run_until(lambda: bool(state.planner), 1.0, "the status")
    world.run(0.1)
    assert np.isnan(latest(world, "solving")).all()


def test_an_idle_planner_has_no_solve_time(world):
    status, state = world.publisher(DiagnosticStatus, "mpc/status"), world.nodes[0].state
    status.publish(planner_status(state="idle", solve_ms=12.5, slack_m=0.004))
    world.run_until(lambda: bool(state.planner), 1.0, "the status")
    world.run(0.1)
    assert np.isnan(latest(world, "solving")).all()


def test_a_route_is_shown_while_it_is_repeated(world):
    world.publisher(Path, "mpc/route").publish(path(7))
    line = world.nodes[0].state.route
    world.run_until(lambda: len(line.points) == 7, 1.0, "the route")
    world.run(0.9)
    assert len(line.points) == 7
    world.run_until(lambda: len(line.points) == 0, 0.3, "its end")


def test_predicted_obstacles_are_outlined(world):
    message = MarkerArray(
        markers=[Marker(action=Marker.DELETEALL), marker(ns="predicted_0"), marker(ns="other")]
    )
    world.publisher(MarkerArray, "mpc/predicted_obstacles").publish(message)
    line = world.nodes[0].state.predicted
    world.run_until(lambda: len(line.points) > 0, 1.0, "the outlines")
    around = line.points[np.isfinite(line.points).all(axis=1)]
    assert np.hypot(*around.T) == pytest.approx(0.3, abs=1e-6)
    assert np.isnan(line.points).any(axis=1).sum() == 2, "a gap after each"
    world.run_until(lambda: len(line.points) == 0, 1.5, "their end")


def test_the_planner_draws_only_for_connected_browsers(world):
    topics = ("mpc/plan", "mpc/route", "mpc/predicted_obstacles", "arm/joint_states", "arm/timing")

    def subscribers():
        world.run(0.05)
        return {world.probe.count_subscribers(topic) for topic in topics}

    world._await(lambda: subscribers() == {1}, "the viewer")
    world.nodes[0].page.watched = False
    world._await(lambda: subscribers() == {0}, "its silence")
    assert world.probe.count_subscribers("mpc/status") == 1
