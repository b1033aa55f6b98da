"""Goals of platform and joints together over real topics, and by the action `move_body`."""

import contextlib
import threading
from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.trajectory_goal import ErrorCode
from test import ros_interfaces
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator_arm import trajectory
from test.nodes.test_path_interpolator_tool import READY
from test.nodes.test_path_interpolator_whole_body import BODY
from test.nodes.test_whole_body_planner import SHORT, DodgeWorld, send_goal
from test.nodes.transforms import Localisation, Transforms, tf_installed
from test.nodes.whole_robot import Post

ARM = READY + [0.5, 0.3, -0.4, 0.2, 0.1, 0.3]  #: Joint angles of goals
GOAL = np.array([0.6, -0.2, 0.4, *ARM])  #: A goal of all axes
FAR = np.array([1.5, -0.2, 0.4, *ARM])  #: One that is farther away
AHEAD = Post(0.9, 0.1, 0.1, (0.0, 1.5))  #: A post between the platform and a goal behind it
AT_GOAL = Post(0.7, -0.2, 0.1, (0.0, 1.5))  #: A post where the platform is to be


def send(world, *rows, names=BODY, frame="", **more):
    """Send a goal, and run until it has arrived."""
    message = trajectory(rows, names=names, **more)
    message.header.frame_id = frame
    world.publisher(JointTrajectory, "joint_goal").publish(message)
    world.run(2 * PERIOD)


def axes(world):
    """Return the axes (9,) of the robot as it is measured."""
    return np.concatenate([world.poses[-1][1:], world.joints])


@pytest.fixture
def world():
    with DodgeWorld() as made:
        yield made


def test_platform_and_joints_arrive_and_both_previews_are_of_the_same_instants(world):
    send(world, GOAL)
    world.run_to_motion_start()
    world.run_to_motion_end(30.0)
    assert world.body.log.text == "arrived"
    assert axes(world) == pytest.approx(GOAL, abs=3e-3)
    assert not world.warnings and not world.tool_references
    platform, arm = world.preview(-1), world.joint_previews[-1][2]
    assert platform.end == pytest.approx(arm.end, abs=PERIOD)


def test_axes_that_are_not_named_stay_and_moveits_names_are_known(world):
    names = ["platform/theta", "platform/x", "elbow_joint", "platform/y"]
    send(world, [0.3, 0.2, 1.8, 0.1], names=names)
    world.run_to_motion_start()
    world.run_to_motion_end(30.0)
    expected = np.array([0.2, 0.1, 0.3, *READY])
    expected[5] = 1.8
    assert axes(world) == pytest.approx(expected, abs=3e-3)


def test_a_pose_in_map_is_reached_where_map_was_when_the_goal_came():
    with tf_installed(), DodgeWorld() as world:
        localisation = Localisation(world, Transforms(world), (3.0, -1.0, 2.0))
        world.run(0.05)
        there = localisation.in_map(GOAL[:3])
        send(world, [*there, *ARM], frame="map")
        localisation.matrix = localisation.matrix @ Localisation._of(0.2, 0.1, 0.1)
        world.run_to_motion_start()
        world.run_to_motion_end(30.0)
        assert axes(world) == pytest.approx(GOAL, abs=3e-3)


@pytest.mark.exhaustive
def test_a_post_on_the_way_is_passed():
    with DodgeWorld(AHEAD) as world:
        send(world, [2.0, 0.0, 0.0, *ARM])
        world.run_to_motion_start()
        world.run_to_motion_end(60.0)
        assert world.body.log.text == "arrived" and world.gap > 0.02


def test_a_goal_replaces_a_path_of_the_tool_and_is_paused_resumed_and_cancelled(world):
    world.lead(SHORT)
    world.run(1.0)
    driven = world.body.log.driven
    send(world, FAR)
    assert driven.outcome == "replaced by a new joint goal"
    world.run_until(lambda: world.body.idle, 2.0, "the rest")
    world.run_until(lambda: world.node.motions.tool.is_planning, 1.0, "the planning")
    world.run_to_motion_start()
    count = len(world.tool_references)
    world.run(1.0)
    assert len(world.tool_references) == count, "no tool is led"
    assert world.call_service("pause").success
    world.run_until(lambda: world.body.core.state is PathState.PAUSED, 2.0, "the pause")
    here = axes(world)
    world.run(1.0)
    assert axes(world) == pytest.approx(here, abs=1e-6)
    assert world.call_service("resume").success
    world.run(1.0)
    assert np.abs(axes(world) - here).max() > 0.05
    assert world.call_service("cancel").success
    world.run_to_motion_end(2.0)
    assert world.body.log.text == "cancelled"
    for request in ("pause", "cancel"):
        assert world.call_service(request).message == f"no motion to {request}: idle"
    end = axes(world)
    world.run(0.5)
    assert axes(world) == pytest.approx(end, abs=1e-6) and np.abs(end - FAR).max() > 0.1


def test_a_platform_that_is_far_off_its_way_ends_the_motion(world):
    send(world, FAR)
    world.run_to_motion_start()
    world.run(1.0)
    world.platform_error = lambda time: np.array([0.0, 0.06, 0.0])
    world.run_to_motion_end(1.0)
    assert "off its path" in world.body.log.text


REFUSED = {
    "unknown joint": ([[1.0]], {"names": ["wrist_9_joint"]}, "no joint wrist_9_joint"),
    "half a pose": ([[1.0]], {"names": ["odom_x"]}, "named together"),
    "too few numbers": ([GOAL[:8]], {}, "8 positions"),
    "no positions": ([], {}, "without positions"),
    "two points": ([GOAL, GOAL], {}, "one point, not 2"),
    "not finite": ([[np.nan, *GOAL[1:]]], {}, "not a finite number"),
    "huge": ([GOAL] * 1000, {}, "0.1 MB, a goal is one point"),
    "in motion": ([GOAL], {"velocities": [np.ones(9)]}, "at rest, without velocities"),
    "accelerating": (
        [GOAL],
        {"velocities": [np.zeros(9)], "accelerations": [np.ones(9)]},
        "at rest, without accelerations",
    ),
    "timed": ([GOAL], {"times": [60.0]}, "as soon as the limits allow: time_from_start is 60 s"),
    "unknown frame": ([GOAL], {"frame": "lidar"}, "lidar"),
    "joint limit": ([[7.0]], {"names": ["elbow_joint"]}, "elbow_joint = 7 rad must be from"),
    "in itself": ([[1.5]], {"names": ["shoulder_lift_joint"]}, "near to platform"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_goal_that_cannot_be_is_refused_before_anything_moves(world, case):
    rows, options, words = REFUSED[case]
    send(world, *rows, **options)
    world.wait_for_plan()
    assert any(words in text for text in world.warnings), world.warnings
    assert world.body.idle and not world.references and not world.joint_previews


def test_rates_that_are_zero_but_for_round_off_are_at_rest(world):
    send(world, GOAL, velocities=[np.full(9, 1e-12)], accelerations=[np.full(9, 1e-12)])
    world.run_to_motion_start()
    assert not world.warnings


def test_a_goal_replaces_a_hold_of_the_tool(world):
    assert world.call_service("hold").success
    world.run_to_motion_start()
    held = world.body.log.driven
    send(world, GOAL)
    assert held.outcome == "replaced by a new joint goal"
    world.run_until(lambda: world.node.motions.tool.is_planning, 2.0, "the planning")
    world.run_to_motion_start()
    world.run_to_motion_end(30.0)
    assert axes(world) == pytest.approx(GOAL, abs=3e-3)


def test_a_goal_replaces_one_that_is_still_being_planned(world):
    release = threading.Event()
    plan = world.body.joint_planner

    def slow(goal, start):
        made = plan(goal, start)
        return lambda: release.wait(10.0) and made()

    world.body.joint_planner = slow
    send(world, FAR)
    (first, _) = world.node.motions.tool._plan
    send(world, GOAL)
    assert first.outcome == "replaced by a new joint goal"
    release.set()
    world._await(world.node.motions.tool._running.done, "the discarded plan")
    world.run_until(lambda: world.node.motions.tool.is_planning, 1.0, "the planning")
    world.run_to_motion_start()
    world.run_to_motion_end(30.0)
    assert axes(world) == pytest.approx(GOAL, abs=3e-3)


@contextlib.contextmanager
def world_without_map():
    """A world in which `map` may come: a goal in it waits."""
    with tf_installed(), DodgeWorld(parameters={"tf.wait": 5.0}) as world:
        transforms = Transforms(world)
        transforms.send("base_link", "lidar", 0.3, 0.0, static=True)
        world.run(0.1)
        yield world, transforms


def test_a_goal_that_waits_for_its_frame_can_be_cancelled():
    with world_without_map() as (world, transforms):
        send(world, FAR, frame="map")
        world.run(0.2)
        assert world.call_service("cancel").success
        assert world.node.motions.tool.log.text == "cancelled"
        Localisation(world, transforms)
        world.run(0.5)
        world.wait_for_plan()
        assert world.body.idle and not world.references


def test_a_goal_whose_frame_is_known_too_late_does_not_replace_a_newer_one():
    with world_without_map() as (world, transforms):
        send(world, FAR, frame="map")
        send_goal(world, 0.2, 0.0, 0.0)
        world.run_to_motion_start()
        newer = world.body.log.driven
        Localisation(world, transforms)
        world.run(0.2)
        assert any("a newer tool goal came" in text for text in world.warnings), world.warnings
        assert world.body.log.driven is newer


@pytest.fixture(scope="module")
def action_type():
    with ros_interfaces.installed("control_msgs"):
        yield import_module("control_msgs.action").FollowJointTrajectory


class GoalClient:
    """A client of the action in a world."""

    def __init__(self, world, kind):
        self.world, self._kind, self.feedback = world, kind, []
        self._client = ActionClient(world.probe, kind, "whole_body_planner/move_body")
        world._await(self._client.server_is_ready, "the action")

    def close(self):
        self._client.destroy()
        for action in self.world.node.actions:
            action.destroy()

    def send(self, row, names=BODY):
        goal = self._kind.Goal(trajectory=trajectory([row], names=names))
        future = self._client.send_goal_async(
            goal, feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self.world._await(future.done, "an answer to a goal")
        return future.result()

    def result(self, future, seconds=60.0):
        self.world.run_until(future.done, seconds, "a result")
        got = future.result()
        return got.status, got.result.error_code, got.result.error_string


@contextlib.contextmanager
def client_of(action_type, *posts):
    with DodgeWorld(*posts) as world:
        client = GoalClient(world, action_type)
        yield client
        client.close()


def test_an_action_reaches_its_goal_and_its_feedback_has_all_axes(action_type):
    with client_of(action_type) as client:
        future = client.send(GOAL).get_result_async()
        assert client.result(future) == (GoalStatus.STATUS_SUCCEEDED, ErrorCode.SUCCESSFUL, "")
        assert len(client.feedback) > 50
        assert tuple(client.feedback[0].joint_names) == BODY
        assert max(np.abs(each.error.positions).max() for each in client.feedback) < 0.02
        assert np.array(client.feedback[-1].actual.positions) == pytest.approx(GOAL, abs=5e-3)
        assert client.world.node.finished


def test_feedback_is_of_the_goal_not_of_the_motion_that_it_replaces(action_type):
    with client_of(action_type) as client:
        world = client.world
        world.lead(SHORT)
        world.run(1.0)
        client.send(GOAL)
        world.run_until(lambda: world.body.idle, 2.0, "the rest")
        assert not client.feedback
        world.run_until(lambda: world.node.motions.tool.is_planning, 1.0, "the planning")
        world.run_to_motion_start()
        world.run(0.3)
        assert client.feedback


def test_an_occupied_goal_is_aborted_with_part_and_obstacle(action_type):
    with client_of(action_type, AT_GOAL) as client:
        future = client.send(GOAL).get_result_async()
        status, code, text = client.result(future)
        assert (status, code) == (GoalStatus.STATUS_ABORTED, ErrorCode.INVALID_GOAL)
        assert "at the goal, " in text and "no room beside obstacle post/0" in text
        assert not client.world.references


def test_a_cancelled_action_ends_at_rest_and_a_bad_goal_is_rejected(action_type):
    with client_of(action_type) as client:
        assert not client.send([1.0], ["odom_x"]).accepted
        handle = client.send(GOAL)
        future = handle.get_result_async()
        client.world.run_to_motion_start()
        client.world.run(1.0)
        handle.cancel_goal_async()
        assert client.result(future, 3.0) == (GoalStatus.STATUS_CANCELED, 0, "cancelled")
        assert 0.02 < axes(client.world)[0] < 0.58
