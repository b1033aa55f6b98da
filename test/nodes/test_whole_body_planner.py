"""Whole-body planner over real topics in simulated time, with a fake controller and arm."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.nodes.whole_body_planner.node import WholeBodyPlannerNode
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator_tool import MODEL, START, ToolWorld
from test.nodes.whole_robot import Judge, Post
from test.tiers import exhaustive

AHEAD = [(0.3, 0.0, 0.0), (1.2, 0.0, 0.0)]  #: A straight path of the tool
SHORT = [(0.2, 0.0, 0.0), (0.2, 0.1, 0.0)]  #: A path with a corner that is done soon
RISING = [(0.3, 0.0, 0.1), (0.8, 0.0, 0.5)]  #: A path that only a tilted tool can follow
#: A post where the platform would be in a fixed posture
BESIDE = Post(1.0, -0.42, 0.1, (0.0, 1.2))
PASSING = Post(0.0, -0.5, 0.1, (0.0, 1.2))  #: A post that comes to stand 5 cm beside the platform
ON_PATH = Post(START[0, 3] + 0.9, START[1, 3], 0.1, (0.0, 1.5))  #: A post on the path of the tool


class DodgeWorld(ToolWorld):
    """A whole-body planner with a fake controller and an arm that follow without delay.

    Attributes:
        posts: Things that the planner hears of, every 0.1 s.
        is_source_silent: Whether nothing is heard of them any more.
        gap: Least distance of the robot from the posts so far [m].
    """

    maker, name, source = WholeBodyPlannerNode, "whole_body_planner", "body"

    def __init__(self, *posts, parameters=None, is_source_silent=False):
        self.posts, self.is_source_silent, self.gap = posts, is_source_silent, np.inf
        self._judge = Judge(posts) if posts else None
        self._markers = None
        super().__init__(parameters)
        if posts:  # who has a publisher is expected to publish
            self._markers = self.publisher(MarkerArray, "obstacles", 50)
        self.hooks.append(self._look)
        self.run(0.2)

    def listen_to_requests(self):
        pass

    def _look(self):
        if self._judge is None:
            return
        pose = np.array(self.poses[-1][1:])
        self.gap = min(self.gap, self._judge.gap(pose, self.joints))
        if not self.is_source_silent and round(self.time / PERIOD) % 20 == 0:
            marks = [post.marker(k, self.stamp()) for k, post in enumerate(self.posts)]
            self._markers.publish(MarkerArray(markers=marks))

    @property
    def body(self):
        return self.node.motions.whole_body

    def lead(self, offsets=AHEAD, **options):
        """Send a path of the tool, and run until it begins."""
        self.send_tool(offsets, **options)
        self.run_to_motion_start()


@pytest.fixture
def world():
    with DodgeWorld() as made:
        yield made


def test_the_tool_follows_its_path_and_both_previews_begin_together(world):
    world.lead(SHORT)
    world.run_to_motion_end(30.0)
    end = world.tool_references[-1].pose.position
    assert [end.x, end.y, end.z] == pytest.approx(START[:3, 3] + SHORT[-1], abs=6e-4)
    assert world.tool_errors().max() < 1e-4
    begins = {round(begin, 6) for _, begin, _ in world.joint_previews}
    stamps = {round(time_seconds(world.message(k).header.stamp), 6) for k in range(2, 30)}
    assert stamps <= begins
    assert not world.warnings and world.status().level == DiagnosticStatus.OK


def test_the_plan_is_published_from_where_the_robot_is_to_rest_while_it_is_followed(world):
    plans, poses = [], []

    def note(message):
        plans.append(message)
        poses.append(np.concatenate([world.poses[-1][1:], world.joints]))

    world.probe.create_subscription(JointTrajectory, "body/plan", note, 10)
    world.run(0.2)
    assert not plans
    world.lead(SHORT)
    world.run(1.0)
    plan = plans[-1]
    assert plan.joint_names == [*PLATFORM_AXES, *world.node.settings.value.arm.joints]
    axes = np.array([point.positions for point in plan.points])
    assert axes[0] == pytest.approx(poses[-1], abs=0.01)
    times = np.array([time_seconds(point.time_from_start) for point in plan.points])
    assert np.diff(times) == pytest.approx(0.5) and times[-1] >= 1.0
    tool = MODEL.forward(axes)[:, :3, 3]
    assert tool[:, 2] == pytest.approx(START[2, 3], abs=1e-4)
    assert np.linalg.norm(tool[-1] - tool[0]) > 0.1
    world.run_to_motion_end(30.0)
    world.run(0.2)
    count = len(plans)
    world.run(0.5)
    assert len(plans) == count


def test_what_cannot_be_is_refused_before_anything_moves():
    with DodgeWorld(ON_PATH) as world:
        world.send_tool(AHEAD)
        world.wait_for_plan()
        assert any("no room beside obstacle" in text for text in world.warnings), world.warnings
        assert world.body.idle and not world.references
        status = world.status()
        assert status.level == DiagnosticStatus.WARN and "no room beside" in status.message


def test_the_path_is_given_up_with_the_reason_when_it_waits_in_vain():
    with DodgeWorld(ON_PATH, parameters={"patience": 1.0}, is_source_silent=True) as world:
        world.lead()
        world.is_source_silent = False
        world.run_to_motion_end(20.0)
        assert "given up: it waited in vain: " in world.body.log.text
        assert "no room beside obstacle" in world.body.log.text
        world.run(0.5)
        assert world.preview(-1).end_speed == 0.0 and world.gap > 0.02


def test_the_status_tells_in_the_next_cycles_what_is_in_the_way_and_that_it_is_gone():
    with DodgeWorld(ON_PATH, is_source_silent=True) as world:
        seen = []
        world.probe.create_subscription(
            DiagnosticStatus,
            "body/status",
            lambda it: seen.append({pair.key: pair.value for pair in it.values}),
            10,
        )
        world.lead()
        world.run(2.6)
        assert seen[-1]["obstruction"] == ""
        world.is_source_silent = False  # the next markers come within 0.1 s
        world.run_until(lambda: seen[-1]["obstruction"] != "", 0.2, "the obstruction")
        assert seen[-1]["obstruction"] == "standing obstacle"
        assert seen[-1]["obstruction_by"] == "obstacle post/0"
        assert seen[-1]["obstruction_part"]
        assert 0.3 < float(seen[-1]["obstruction_place"]) < 0.9
        world.posts = ()  # its marker lives for 1 s
        world.run_until(lambda: seen[-1]["obstruction"] == "", 1.2, "the clear plan")
        assert world.gap > 0.02


@pytest.mark.exhaustive
def test_a_silent_source_of_obstacles_brings_the_robot_to_rest_until_it_is_heard():
    with DodgeWorld(BESIDE) as world:
        world.lead()
        world.run(1.5)
        world.is_source_silent = True
        world.run(2.5)
        here = world.tool_references[-1].pose.position.x
        world.run(1.0)
        assert world.tool_references[-1].pose.position.x == pytest.approx(here, abs=1e-9)
        assert "obstacles" in world.status().message
        world.is_source_silent = False
        world.run_to_motion_end(40.0)
        assert world.body.log.text == "arrived" and world.gap > 0.02


def test_pause_resume_and_cancel_keep_the_tool_on_its_path(world):
    world.lead()
    world.run(2.0)
    assert world.call_service("pause").success
    world.run_until(lambda: world.body.core.state is PathState.PAUSED, 2.0, "the pause")
    world.run(0.1)
    here = world.tool_references[-1].pose.position.x
    world.run(1.5)
    assert world.tool_references[-1].pose.position.x == pytest.approx(here, abs=1e-9)
    assert world.status().level == DiagnosticStatus.OK
    assert world.call_service("resume").success
    world.run(1.5)
    assert world.tool_references[-1].pose.position.x > here + 0.05
    assert world.call_service("cancel").success
    world.run_to_motion_end(2.0)
    assert world.body.log.text == "cancelled"
    assert world.tool_errors().max() < 1e-4
    assert not world.call_service("resume").success


def test_a_held_tool_stays_until_cancel_while_the_body_gives_way():
    with DodgeWorld(PASSING, parameters={"patience": 1.0}, is_source_silent=True) as world:
        answer = world.call_service("hold")
        assert answer.success and "hold of the tool" in answer.message
        world.run_to_motion_start()
        world.run(0.5)
        world.is_source_silent = False
        world.run(2.0)
        assert max(y for _, _, y, _ in world.poses) > 0.01, "it did not give way"
        tool = world.tool_references[-1].pose.position
        assert [tool.x, tool.y, tool.z] == pytest.approx(START[:3, 3], abs=1e-6)
        assert world.tool_errors().max() < 1e-4
        assert not world.body.idle and not world.warnings
        refused = world.call_service("hold")
        assert not refused.success and "~/cancel ends it" in refused.message
        assert world.call_service("cancel").success
        world.run_to_motion_end(2.0)
        assert world.body.log.text == "cancelled"


@pytest.mark.exhaustive
def test_the_speed_scaling_of_the_arm_slows_platform_and_tool(world):
    world.lead()
    world.run(2.0)

    def speed():
        before = world.tool_references[-1].pose.position.x
        world.run(0.5)
        return (world.tool_references[-1].pose.position.x - before) / 0.5

    full, world.scaling = speed(), 0.5
    world.run(0.5)
    assert speed() == pytest.approx(0.5 * full, rel=0.05)
    world.scaling = 1.0
    world.run_to_motion_end(30.0)
    assert world.tool_errors().max() < 1e-4


def test_the_last_previews_lead_to_rest_on_the_path_of_the_tool(world):
    """So platform and arm rest there together if the planner is killed."""
    world.lead()
    world.run(2.0)
    platform, arm = world.preview(-1), world.joint_previews[-1][2]
    assert platform.end == pytest.approx(arm.end, abs=PERIOD)
    times = np.linspace(world.time, platform.end, 30)
    axes = np.array([[*platform.sample(t).pose, *arm.sample(t)[0]] for t in times])
    tool = MODEL.forward(axes)[:, :3, 3]
    assert np.abs(tool[:, 1:] - START[1:3, 3]).max() < 1e-5
    assert tool[-1, 0] - tool[0, 0] > 0.08, "it goes on at first"
    assert platform.end_speed < 1e-6 and np.abs(arm.sample(arm.end)[1]).max() < 1e-6


def test_a_platform_that_is_far_off_its_path_ends_it(world):
    world.lead()
    world.run(1.0)
    world.platform_error = lambda time: np.array([0.0, 0.06, 0.0])
    world.run_to_motion_end(1.0)
    assert "off its path" in world.body.log.text


@pytest.mark.parametrize("source", [exhaustive("stop"), "cmd_vel", exhaustive("mpc")])
def test_who_takes_the_platform_ends_the_path_for_good(world, source):
    world.lead()
    world.run(1.0)
    world.follows_stream = False
    world.publish_source(source)
    world.run_to_motion_end(0.5)
    assert "given up" in world.body.log.text
    count = len(world.references)
    world.publish_source("none")
    world.run(3.0)
    assert len(world.references) <= count + 1 and world.body.idle


def test_an_emergency_stop_ends_the_path_and_refuses_another(world):
    world.lead()
    world.run(1.0)
    button = world.publisher(Bool, "emergency_stop", LATCHED)
    button.publish(Bool(data=True))
    world.run_to_motion_end(0.5)
    assert "emergency_stop is true" in world.body.log.text
    world.send_tool(AHEAD)
    world.wait_for_plan()
    assert world.body.idle and "emergency_stop" in world.node.motions.tool.log.text


@pytest.mark.exhaustive
def test_silent_odometry_rests_the_robot_and_ends_the_path(world):
    world.lead()
    world.run(1.0)
    world.odometry = None
    world.run_to_motion_end(1.0)
    assert "no odom" in world.body.log.text


REFUSED = {
    "too high": ([(0.1, 0, 0), (0.2, 0, 1.5)], {}, "no place from which the arm reaches"),
    "far away": ([(3.0, 0, 0), (4.0, 0, 0)], {}, "from the tool"),
    "no pose": ([], {}, "empty"),
    "wrong frame": (AHEAD, {"frame": "map"}, "frame 'map'"),
    "not finite": ([(0.1, np.nan, 0)], {}, "not finite"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_impossible_path_is_refused_before_anything_moves(world, case):
    offsets, options, words = REFUSED[case]
    world.send_tool(offsets, **options)
    world.wait_for_plan()
    assert any(words in text for text in world.warnings), world.warnings
    assert world.body.idle and not world.references and not world.joint_previews


def test_a_free_axis_counts_from_the_next_path_on(world):
    assert not world.set("orientation.cone", 0.2).successful, "there is no axis yet"
    world.send_tool(RISING)
    world.wait_for_plan()
    assert any("from which the arm reaches" in text for text in world.warnings), world.warnings
    assert world.set("orientation.free_axis", "x").successful
    world.lead(RISING)
    free = world.body.core.task.redundancy.free
    assert world.set("orientation.free_axis", "none").successful
    world.run_to_motion_end(40.0)
    assert free is not None
    end = world.tool_references[-1].pose
    reached = [end.position.x, end.position.y, end.position.z]
    assert reached == pytest.approx(START[:3, 3] + RISING[-1], abs=6e-4)
    assert world.tool_errors().max() < 1e-4
    x, y, z, w = (getattr(end.orientation, name) for name in "xyzw")
    axis = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    assert axis == pytest.approx(START[:3, 0], abs=1e-3)
    assert abs(2 * (y * z + x * w) - START[2, 1]) > 0.1, "it has turned about x"


def test_a_wall_of_the_map_counts_and_unknown_cells_by_parameter(world):
    maps = world.publisher(OccupancyGrid, "map", LATCHED)
    grid = OccupancyGrid()
    grid.header.frame_id, grid.header.stamp = "odom", world.stamp()
    grid.info.resolution, grid.info.width, grid.info.height = 0.05, 4, 120
    grid.info.origin.position.x, grid.info.origin.position.y = 1.0, -3.0
    grid.info.origin.orientation.w = 1.0
    grid.data = [-1] * 480
    maps.publish(grid)
    world.run(0.2)
    assert world.set("map_unknown_is_free", False).successful
    world.send_tool(AHEAD)
    world.wait_for_plan()
    assert any("no room beside" in text for text in world.warnings), world.warnings
    assert world.set("map_unknown_is_free", True).successful
    world.lead()
    assert not world.body.idle


def tool_goal(offset, frame="odom"):
    """Return a goal at an offset from the first pose of the tool, which keeps its orientation."""
    goal = PoseStamped()
    goal.header.frame_id = frame
    place = (START[:3, 3] + offset).tolist()
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = place
    goal.pose.orientation.w = 0.0
    return goal


def send_goal(world, *offset, **options):
    world.publisher(PoseStamped, "tool_goal").publish(tool_goal(offset, **options))
    world.run(2 * PERIOD)


@pytest.mark.exhaustive
def test_the_tool_goes_around_a_post_to_its_goal():
    post = Post(START[0, 3] + 0.7, START[1, 3], 0.1, (0.0, 1.5))
    with DodgeWorld(post) as world:
        send_goal(world, 1.5, 0.0, 0.0)
        world.run_to_motion_start()
        world.run_to_motion_end(60.0)
        assert world.body.log.text == "arrived"
        end = world.tool_references[-1].pose.position
        assert [end.x, end.y, end.z] == pytest.approx(START[:3, 3] + [1.5, 0, 0], abs=6e-4)
        assert world.tool_errors().max() < 1e-4 and world.gap > 0.02


@pytest.mark.exhaustive
def test_a_goal_whose_way_is_blocked_later_is_reached_by_another_one():
    post = Post(START[0, 3] + 0.7, START[1, 3], 0.1, (0.0, 1.5))
    with DodgeWorld(post, is_source_silent=True) as world:
        send_goal(world, 1.5, 0.0, 0.0)
        world.run_to_motion_start()
        world.is_source_silent = False
        while not world.body.idle:
            world.run(0.5)
            search = world.body._search  # in real time
            world._await(lambda search=search: search is None or search.done(), "the search")
        assert world.body.log.text == "arrived"
        end = world.tool_references[-1].pose.position
        assert [end.x, end.y, end.z] == pytest.approx(START[:3, 3] + [1.5, 0, 0], abs=6e-4)
        assert world.tool_errors().max() < 1e-3 and world.gap > 0.02


def test_a_goal_replaces_what_is_driven_and_begins_where_the_robot_rests(world):
    world.lead()
    world.run(2.0)
    driven = world.body.log.driven
    send_goal(world, 0.0, 0.0, 0.05)
    assert driven.outcome == "replaced by a new tool goal"
    assert not world.body.idle, "it brakes"
    send_goal(world, 0.0, 0.1, 0.05)  # replaces the goal that waits
    world.run_until(lambda: world.body.idle, 2.0, "the rest")
    world.run_until(lambda: world.node.motions.tool.is_planning, 1.0, "the planning")
    world.run_to_motion_start()
    world.run_to_motion_end(30.0)
    end = world.tool_references[-1].pose.position
    assert [end.x, end.y, end.z] == pytest.approx(START[:3, 3] + [0.0, 0.1, 0.05], abs=6e-4)
    assert world.tool_errors().max() < 1e-4


BAD_GOALS = {
    "too high": ((0.1, 0.0, 1.5), {}, "no place from which the arm reaches"),
    "not finite": ((np.nan, 0.0, 0.0), {}, "not finite"),
    "huge": ((1e9, 0.0, 0.0), {}, "positions"),
    "unknown frame": ((0.1, 0.0, 0.0), {"frame": "lidar"}, "lidar"),
}


@pytest.mark.parametrize("case", BAD_GOALS)
def test_a_goal_that_cannot_be_is_refused_before_anything_moves(world, case):
    offset, options, words = BAD_GOALS[case]
    send_goal(world, *offset, **options)
    world.wait_for_plan()
    assert any(words in text for text in world.warnings), world.warnings
    assert world.body.idle and not world.references and not world.joint_previews
