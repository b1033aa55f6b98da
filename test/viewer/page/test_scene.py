"""Tests of the scene on a real server without a browser: its messages to viser and drags."""

import asyncio
import contextlib
import io
import math
from types import SimpleNamespace

import numpy as np
import pytest
import viser
from viser._messages import ScenePointerMessage

from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.viewer import style
from omniman_ros.viewer.body_view import BodyView, Nearest, PlanView
from omniman_ros.viewer.events import (
    GoalDragged,
    ObstacleDragged,
    ObstacleSelected,
    ObstacleVelocitySet,
    StartDragged,
)
from omniman_ros.viewer.lines import outlines
from omniman_ros.viewer.map_image import map_image, map_pixels
from omniman_ros.viewer.obstacle_paths import WaypointPath
from omniman_ros.viewer.optimistic_updates import DRAG_TIMEOUT, RELEASE_TIMEOUT
from omniman_ros.viewer.page.draggable_markers import ARROW_HEIGHT, OPAQUE, PALE, REST_SPEED
from omniman_ros.viewer.page.floor_scene import dashes, rectangle
from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.scene import PageScene
from omniman_ros.viewer.perceived import LAYERS, Contact, Tracks
from omniman_ros.viewer.placed_obstacles import MAX_VELOCITY, PlacedObstacles
from omniman_ros.viewer.view_state import ViewState
from test import robots

HOST = "127.0.0.1"
MOUNT = Mount()
EYE = np.array([-3.0, 1.0, 2.5])
ARM = np.array([0.4, -1.1, 1.5, -0.4, 1.2, 0.0])


class Stage:
    """A scene with its state, its clock and the events that it has posted."""

    def __init__(self, mount=MOUNT, name="omniman"):
        robot = robots.robot(name)
        self.robot = robot
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=HOST, port=free_port(HOST, 18280), verbose=False)
        self.clients = {7: SimpleNamespace(camera=SimpleNamespace(position=EYE))}
        self.server.get_clients = lambda: self.clients
        self.events, self.now = [], 100.0
        self.scene = PageScene(self.server, robot, mount, self.events.append, lambda: self.now)
        self.state = ViewState(robot.wheel_count, robot.wheel_count - 3)
        self.obstacles = PlacedObstacles()
        self.follow = False

    def close(self):
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __getitem__(self, name):
        return self.server.scene.get_handle_by_name(f"/world/{name}")

    def draw(self, lines=False):
        self.state.obstacles = self.obstacles.arrays(self.now)
        self.scene.draw(self.state, self.follow)
        if lines:
            self.scene.draw_lines(self.state)

    def report(self, name, phase, start, end, index=None):
        """Report a drag as viser does, and return the events posted for it."""
        handle, posted = self[name], len(self.events)
        event = SimpleNamespace(
            client=SimpleNamespace(camera=SimpleNamespace(position=EYE)),
            client_id=7,
            target=handle,
            phase=phase,
            instance_index=index,
            start_position=tuple(start),
            end_position=tuple(end),
        )
        (entry,) = handle._impl.drag_cb
        assert asyncio.iscoroutinefunction(entry.callback), (
            "other callbacks would run out of order"
        )
        asyncio.run(entry.callback(event))
        return self.events[posted:]

    def drag(self, name, grabbed, to, index=None, end="end"):
        """Grab a point of an object and drag it to another one at the same height."""
        grabbed, to = np.array(grabbed, dtype=float), np.array(to, dtype=float)
        # viser reports a point on another plane, on the same ray.
        pointer = EYE + 0.8 * (to - EYE)
        assert self.report(name, "start", grabbed, grabbed, index) == []
        moved = self.report(name, "update", grabbed, pointer, index)
        return moved if end is None else moved + self.report(name, end, grabbed, pointer, index)

    def click_ray(self, origin, direction):
        """Report a click as viser does."""
        message = ScenePointerMessage(
            "click", tuple(origin), tuple(direction), ((0.5, 0.5),), None
        )
        self.server.scene._get_client_handle = self.clients.get
        asyncio.run(self.server.scene._handle_scene_pointer_updates(7, message))


@pytest.fixture
def make_stage():
    made = []

    def make(*given, **named):
        made.append(Stage(*given, **named))
        return made[-1]

    yield make
    for stage in made:
        stage.close()


@pytest.fixture
def stage(make_stage):
    return make_stage()


def test_the_arm_is_hidden_until_its_joint_states_arrive(stage):
    stage.draw()
    assert not stage["robot/arm"].visible
    still = stage["robot/arm/tubes"].batched_positions.copy()
    stage.state.update_arm(ARM, 1.0)
    stage.draw()
    assert stage["robot/arm"].visible
    moved = np.linalg.norm(stage["robot/arm/tubes"].batched_positions - still, axis=1)
    assert moved[0] == 0.0 and moved[-1] > 0.1, "the foot stands, the flange moves"


def test_a_robot_without_an_arm_shows_none(make_stage):
    stage = make_stage(mount=None)
    stage.state.update_arm(ARM, 1.0)
    stage.draw()
    assert stage["robot/arm"] is None


def test_unchanged_values_are_not_sent_again(stage, monkeypatch):
    state = stage.state
    state.update_odom((1.0, 2.0, 0.3), 1.0)
    state.update_arm(ARM, 1.0)
    state.goal = (1.0, 1.0, 0.0)
    state.path.set(np.array([[0.0, 0.0], [1.0, 0.0]]))
    stage.obstacles.add(TwoVelocityPath((1.0, 1.0)), stage.now)
    stage.follow = True
    stage.draw(lines=True)
    sent = []
    monkeypatch.setattr(stage.server.scene, "_queue_scene_message", sent.append)
    stage.draw(lines=True)
    assert sent == []
    state.goal = (1.0, 1.1, 0.0)
    stage.draw(lines=True)
    assert [message.name for message in sent] == ["/world/goal"], "it is watched"


def test_start_and_goal_are_drawn_at_their_poses(stage):
    stage.state.start, stage.state.goal = (1.0, 2.0, 0.5), (3.0, 0.0, -1.0)
    stage.draw()
    assert stage["start"].visible and stage["start"].position == pytest.approx([1.0, 2.0, 0.0])
    assert stage["goal"].position == pytest.approx([3.0, 0.0, 0.0])
    assert stage["goal"].wxyz == pytest.approx([math.cos(-0.5), 0.0, 0.0, math.sin(-0.5)])
    stage.state.start = None
    stage.draw()
    assert not stage["start"].visible


def test_an_unset_goal_is_drawn_pale_ahead_of_the_robot(stage):
    stage.draw()
    assert not stage["goal"].visible, "nobody knows where the robot is"
    stage.state.update_odom((1.0, 2.0, math.pi / 2), 1.0)
    stage.draw()
    goal = stage["goal"]
    assert goal.visible and stage["goal/border"].opacity == PALE
    assert goal.position[0] == pytest.approx(1.0)
    assert goal.position[1] > 2.0 + stage.robot.body.length, "it does not overlap the robot"
    stage.state.goal = (5.0, 0.0, 0.0)
    stage.draw()
    assert stage["goal/border"].opacity == OPAQUE and goal.position[0] == 5.0


@pytest.mark.parametrize(
    ("name", "kind"), [("goal", GoalDragged), ("start", StartDragged)], ids=["goal", "start"]
)
def test_a_dragged_plate_moves_the_marker_and_keeps_its_heading(stage, name, kind):
    setattr(stage.state, name, (2.0, 1.0, 0.7))
    stage.draw()
    posted_events = stage.drag(f"{name}/plate", (2.2, 0.9, 0.01), (3.2, 0.4, 0.01))
    assert [type(event) for event in posted_events] == [kind, kind]
    assert [event.done for event in posted_events] == [False, True]
    for event in posted_events:
        assert event.pose == pytest.approx((3.0, 0.5, 0.7))


def test_a_dragged_knob_turns_the_marker_about_its_middle(stage):
    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    tip = stage["goal/knob"].vertices[:, 0].mean()
    # Grabbed off its centre, and dragged a quarter turn around.
    grabbed, to = (2.0 + tip + 0.03, 1.02, 0.05), (2.03, 1.02 + tip, 0.05)
    (_, last) = stage.drag("goal/knob", grabbed, to)
    assert last.done and last.pose == pytest.approx((2.0, 1.0, math.pi / 2), abs=1e-6)


def test_a_dragged_marker_follows_the_pointer_before_the_state_changes(stage):
    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    assert stage["goal"].position == pytest.approx([3.0, 1.0, 0.0])


def test_a_released_marker_returns_to_the_confirmed_pose(stage):
    stage.state.start = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("start/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01))
    stage.draw()
    stage.now += RELEASE_TIMEOUT
    stage.draw()
    assert stage["start"].position == pytest.approx([2.0, 1.0, 0.0]), "refused"


def test_a_stalled_browser_ends_its_drag_without_sending_the_goal(stage):
    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    stage.now += DRAG_TIMEOUT
    stage.draw()
    assert stage["goal"].position == pytest.approx([2.0, 1.0, 0.0])
    assert [event.done for event in stage.events] == [False]


def test_a_drag_continues_after_a_long_rest(stage):
    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    stage.now += 2 * DRAG_TIMEOUT
    stage.draw()
    pointer = EYE + 0.8 * (np.array([3.0, 1.0, 0.01]) - EYE)
    (last,) = stage.report("goal/plate", "end", (0, 0, 0), pointer)
    assert last.done and last.pose == pytest.approx((3.0, 1.0, 0.0))


def test_a_disconnected_browser_does_not_send_the_goal(stage):
    """viser ends its drag as if it had been released."""
    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.clients.clear()
    assert stage.report("goal/plate", "end", (0, 0, 0), (3.0, 1.0, 0.01)) == []
    assert stage.report("goal/plate", "update", (0, 0, 0), (4.0, 1.0, 0.01)) == [], "not held"


def test_a_drag_is_relative_to_the_floor_that_follows_the_robot(stage):
    stage.state.update_odom((10.0, -4.0, 0.0), 1.0)
    stage.state.goal = (12.0, -3.0, 0.0)
    stage.follow = True
    stage.draw()
    assert stage.server.scene.get_handle_by_name("/world").position[:2].tolist() == [-10.0, 4.0]
    posted_events = stage.drag("goal/plate", (2.0, 1.0, 0.01), (2.5, 0.0, 0.01))
    assert posted_events[-1].pose == pytest.approx((12.5, -4.0, 0.0))
    stage.draw()
    stage.now += DRAG_TIMEOUT
    stage.draw()
    stage.report("goal/plate", "start", (2.0, 1.0, 0.01), (2.0, 1.0, 0.01))
    stage.state.update_odom((10.5, -4.0, 0.0), 2.0)
    stage.draw()
    (posted_events,) = stage.report("goal/plate", "end", (0, 0, 0), (2.0, 1.0, 0.01))
    assert posted_events.pose == pytest.approx((12.5, -3.0, 0.0)), (
        "the floor has moved below the pointer"
    )


def test_an_unknown_camera_moves_nothing(stage):
    class Unknown:
        @property
        def position(self):
            raise AssertionError

    stage.state.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.report("goal/plate", "start", (2.0, 1.0, 0.01), (2.0, 1.0, 0.01))
    (entry,) = stage["goal/plate"]._impl.drag_cb
    asyncio.run(
        entry.callback(
            SimpleNamespace(
                client=SimpleNamespace(camera=Unknown()),
                client_id=7,
                phase="end",
                target=stage["goal/plate"],
                end_position=(3.0, 1.0, 0.01),
            )
        )
    )
    assert stage.events == [GoalDragged((2.0, 1.0, 0.0), True)]


def test_obstacles_are_drawn_where_they_are_placed(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 2.0)), stage.now, (0.3, 0.2), 0.5)
    stage.obstacles.add(TwoVelocityPath((3.0, -1.0)), stage.now)
    stage.state.selected_obstacle = 1
    stage.draw()
    obstacles = stage["obstacles"]
    assert obstacles.batched_positions == pytest.approx(np.array([[1, 2, 0], [3, -1, 0]]))
    assert obstacles.batched_scales == pytest.approx(np.array([[0.3, 0.2, 1], [0.25, 0.25, 1]]))
    assert obstacles.batched_wxyzs[0] == pytest.approx([math.cos(0.25), 0, 0, math.sin(0.25)])
    assert obstacles.batched_colors.tolist() == [
        list(style.PLACED_OBSTACLE),
        list(style.SELECTED_OBSTACLE),
    ]


def test_any_number_of_obstacles_is_shown_by_one_batch(stage):
    stage.draw()
    obstacles = stage["obstacles"]
    assert not obstacles.visible and not stage["obstacles_arrows"].visible
    for count in (1, 3):
        stage.obstacles.add(TwoVelocityPath((float(count), 0.0)), stage.now)
        stage.obstacles.add(TwoVelocityPath((float(count), 1.0)), stage.now)
        stage.draw()
        for name in ("obstacles", "obstacles_arrows"):
            handle = stage[name]
            shapes = [
                getattr(handle, f"batched_{what}").shape
                for what in ("positions", "wxyzs", "scales", "colors")
            ]
            assert handle.visible and shapes == [(count + 1, k) for k in (3, 4, 3, 3)]
    stage.obstacles.delete(None)
    stage.draw()
    assert not obstacles.visible and stage["obstacles"] is obstacles


def test_a_dragged_obstacle_posts_its_number_and_position(stage):
    stage.obstacles.add(TwoVelocityPath((0.0, 0.0)), stage.now)
    number = stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.obstacles.delete(0)
    stage.draw()
    posted_events = stage.drag("obstacles", (1.1, 0.4, 0.55), (1.6, 1.4, 0.55), index=0)
    assert posted_events[-1] == ObstacleDragged(number, pytest.approx((1.5, 1.5)), True)
    assert not posted_events[0].done
    stage.draw()
    assert stage["obstacles"].batched_positions[0] == pytest.approx([1.5, 1.5, 0.0])
    assert stage["obstacles_arrows"].batched_positions[0] == pytest.approx(
        [1.5, 1.5, ARROW_HEIGHT]
    )


def test_an_arrow_ends_where_its_obstacle_will_be_in_a_second(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5), (0.3, -0.4)), stage.now)
    for paused in (False, True):
        (stage.obstacles.pause if paused else stage.obstacles.resume)(stage.now)
        stage.draw()
        arrows = stage["obstacles_arrows"]
        assert arrows.batched_positions[0] == pytest.approx([1.3, 0.1, ARROW_HEIGHT])
        assert stage["obstacles_shafts"].points[0, 1] == pytest.approx([1.3, 0.1, ARROW_HEIGHT])
        assert stage["obstacles_shafts"].visible


def test_a_dragged_arrow_sets_the_velocity_of_its_obstacle(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.draw()
    assert not stage["obstacles_shafts"].visible, "it stands"
    posted_events = stage.drag(
        "obstacles_arrows", (1.05, 0.5, ARROW_HEIGHT), (1.45, 0.9, ARROW_HEIGHT), index=0
    )
    assert posted_events == [ObstacleVelocitySet(0, pytest.approx((0.4, 0.4)))] * 2
    stage.draw()
    assert stage["obstacles_arrows"].batched_positions[0] == pytest.approx(
        [1.4, 0.9, ARROW_HEIGHT]
    )


def test_an_arrow_dragged_to_the_centre_stops_its_obstacle(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5), (0.5, 0.0)), stage.now)
    stage.draw()
    near = 1.0 + 0.5 * REST_SPEED
    posted_events = stage.drag(
        "obstacles_arrows", (1.5, 0.5, ARROW_HEIGHT), (near, 0.5, ARROW_HEIGHT), index=0
    )
    assert posted_events[-1].velocity == (0.0, 0.0)


def test_an_arrow_is_limited_to_the_largest_velocity(stage):
    number = stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.draw()
    posted_events = stage.drag(
        "obstacles_arrows", (1.0, 0.5, ARROW_HEIGHT), (9.0, -8.0, ARROW_HEIGHT), index=0
    )
    assert posted_events[-1].velocity == (MAX_VELOCITY, -MAX_VELOCITY)
    stage.obstacles.set_velocity(number, posted_events[-1].velocity, stage.now)


def test_an_obstacle_deleted_during_a_drag_gets_no_velocity(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.draw()
    stage.report(
        "obstacles_arrows", "start", (1.0, 0.5, ARROW_HEIGHT), (1.0, 0.5, ARROW_HEIGHT), 0
    )
    stage.obstacles.delete(None)
    stage.draw()
    assert stage.report("obstacles_arrows", "update", (0, 0, 0), (1.5, 0.5, ARROW_HEIGHT), 0) == []


def test_an_index_out_of_range_grabs_nothing(stage):
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.draw()
    for index in (None, 1):
        for name in ("obstacles", "obstacles_arrows"):
            assert stage.drag(name, (1.0, 0.5, 0.6), (1.5, 0.5, 0.6), index=index) == []


def test_a_clicked_obstacle_is_selected(stage):
    stage.obstacles.add(TwoVelocityPath((0.0, 0.0)), stage.now)
    stage.obstacles.add(TwoVelocityPath((1.0, 0.5)), stage.now)
    stage.obstacles.delete(0)
    stage.draw()
    (entry,) = stage["obstacles"]._impl.click_cb
    for index in (0, 1, None):
        asyncio.run(entry.callback(SimpleNamespace(instance_index=index)))
    assert stage.events == [ObstacleSelected(1)]


def test_turns_and_way_points_are_drawn_on_the_floor(stage):
    stage.draw()
    assert not stage["obstacle_paths"].visible and not stage["waypoints"].visible
    stage.obstacles.add(TwoVelocityPath((0.0, 0.0), (1.0, 0.0)), stage.now)
    stage.obstacles.add(TwoVelocityPath((0.0, 0.0), (1.0, 0.0), 1.0, (0.0, 0.5)), stage.now)
    stage.obstacles.add(WaypointPath(((1.0, 0.5), (2.0, 0.5), (2.0, 1.5))), stage.now)
    stage.draw()
    pieces = stage["obstacle_paths"].points[:, :, :2]
    loop = [[[1, 0.5], [2, 0.5]], [[2, 0.5], [2, 1.5]], [[2, 1.5], [1, 0.5]]]
    assert pieces == pytest.approx(np.array([[[0, 0], [1, 0]], [[1, 0], [1, 1]], *loop]))
    discs = stage["waypoints"].batched_positions
    assert discs == pytest.approx(np.array([[1, 0.5, 0], [2, 0.5, 0], [2, 1.5, 0]]))
    stage.obstacles.delete(None)
    stage.draw()
    assert not stage["obstacle_paths"].visible and not stage["waypoints"].visible


def test_a_dragged_way_point_moves_and_the_others_stay(stage):
    stage.obstacles.add(WaypointPath(((5.0, 5.0),)), stage.now)
    path = WaypointPath(((1.0, 0.5), (2.0, 0.5)))
    number = stage.obstacles.add(path, stage.now)
    stage.draw()
    posted = stage.drag("waypoints", (2.02, 0.5, 0.03), (2.52, 1.5, 0.03), index=2)
    assert posted[-1].number == number and posted[-1].path.points[0] == (1.0, 0.5)
    assert posted[-1].path.points[1] == pytest.approx((2.5, 1.5))
    assert stage.drag("waypoints", (2.0, 0.5, 0.03), (2.5, 1.5, 0.03), index=3) == []


def click_floor(stage, *place):
    """Click a position in `odom`; the world follows the robot."""
    x, y = stage.server.scene.get_handle_by_name("/world").position[:2]
    ray = np.array([place[0] + x, place[1] + y, 0.0]) - EYE
    stage.click_ray(EYE, ray / np.linalg.norm(ray))


def test_a_click_on_the_floor_is_reported_in_odom_while_there_is_a_listener(stage):
    stage.state.update_odom((10.0, -4.0, 0.0), 1.0)
    stage.follow = True
    stage.draw()
    places = []
    for listener in (None, places.append, places.append, None):
        stage.scene.clicks.listen(listener)
        click_floor(stage, 11.0, -3.0)
    assert places == [pytest.approx((11.0, -3.0))] * 2


@pytest.mark.parametrize("ray", [(1.0, 0.0, 0.0), (1.0, 0.0, 0.5), (1.0, 0.0, math.nan)])
def test_a_click_above_the_horizon_is_none_on_the_floor(stage, ray):
    places = []
    stage.scene.clicks.listen(places.append)
    stage.click_ray(EYE, ray)
    assert places == []


def test_obstacles_of_other_sources_are_drawn_but_cannot_be_dragged(stage):
    centers, axes = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.3, 0.2], [0.1, 0.1]])
    stage.state.other_obstacles = Ellipses(
        0.0, centers, np.zeros((2, 2)), axes, np.array([0.4, 0.0]), np.zeros(2)
    )
    stage.draw()
    other_obstacles = stage["other_obstacles"]
    assert other_obstacles.visible and other_obstacles.batched_positions[:, :2] == pytest.approx(
        centers
    )
    assert other_obstacles.batched_scales[:, :2] == pytest.approx(axes)
    assert other_obstacles._impl.drag_cb == []
    stage.state.other_obstacles = Ellipses.none()
    stage.draw()
    assert not other_obstacles.visible


def test_nothing_casts_a_shadow_or_is_simplified(stage):
    handles = [stage.server.scene.get_handle_by_name(n) for n in names(stage)]
    meshes = [handle for handle in handles if hasattr(handle, "cast_shadow")]
    assert len(meshes) > 15
    for handle in meshes:
        assert not handle.cast_shadow and not handle.receive_shadow
        if isinstance(handle, viser.BatchedMeshHandle):
            assert handle.lod == "off"


def names(stage):
    return list(stage.server.scene._handle_from_node_name)


def test_plan_and_reference_are_drawn_with_every_frame(stage):
    stage.state.update_line("plan", np.array([[0.0, 0.0], [1.0, 0.5]]), 1.0)
    stage.state.update_line("reference", np.array([[0.0, 0.0], [0.5, 0.0]]), 1.0)
    stage.scene.draw(stage.state, False)
    for name in ("plan", "reference"):
        handle = stage.server.scene.get_handle_by_name(f"/world/{name}")
        assert handle.visible and len(handle.points) == 1


def test_outlines_are_not_connected_to_each_other(stage):
    stage.state.predicted.set(
        outlines(np.array([[0.0, 0.0], [5.0, 0.0]]), np.full((2, 2), 0.3), np.zeros(2))
    )
    stage.draw(lines=True)
    lengths = np.linalg.norm(np.diff(stage["predicted"].points, axis=1), axis=2)
    assert len(lengths) == 48 and lengths.max() < 0.1, "no piece leads to the next outline"


def test_the_path_of_the_tool_is_drawn_in_space(stage):
    points = np.array([[0.0, 0.0, 0.8], [0.5, 0.0, 1.0], [1.0, 0.5, 1.2]])
    stage.state.tool_path.set(points)
    stage.draw(lines=True)
    assert stage["tool_path"].points[:, 0] == pytest.approx(points[:-1])
    assert stage["tool_path"].points[:, 1] == pytest.approx(points[1:])
    stage.state.tool_path.set(points[:0])
    stage.draw(lines=True)
    assert not stage["tool_path"].visible


def test_a_workspace_is_drawn_unless_it_is_unbounded(stage):
    for bounds, shown in (
        (None, False),
        ((-1.0, -2.0, 3.0, 4.0), True),
        ((-1e3, -2.0, 1e3, 4.0), False),
        ((-1.0, -1e3, 3.0, 1e3), False),
        ((-5.0, -2.0, 3.0, 4.0), True),
        (None, False),
    ):
        stage.state.workspace = bounds
        stage.draw(lines=True)
        assert stage["workspace"].visible == shown
        if shown:
            points = stage["workspace"].points[:, :, :2].reshape(-1, 2)
            assert [*points.min(axis=0), *points.max(axis=0)] == pytest.approx(bounds)
    assert rectangle((0.0, 0.0, 1.0, 2.0)).shape == (5, 2)


def test_dashes_lie_on_the_line_and_are_as_long_as_their_gaps():
    line = np.array([[0.0, 0.0], [3.0, 0.0], [10.0, 0.0]])
    pieces = dashes(line, dash=0.5)
    assert pieces[0, 0] == pytest.approx([0.0, 0.0]) and pieces[-1, 1] == pytest.approx([10, 0])
    lengths = pieces[:, 1, 0] - pieces[:, 0, 0]
    gaps = pieces[1:, 0, 0] - pieces[:-1, 1, 0]
    assert len(pieces) == 10 and lengths.min() >= 0.5
    assert lengths == pytest.approx(lengths[0]) and gaps == pytest.approx(lengths[0])


@pytest.mark.parametrize("count", [0, 1])
def test_a_line_of_zero_length_has_no_dashes(count):
    assert dashes(np.zeros((count, 2))).shape == (0, 2, 2)


def test_the_number_of_dashes_of_a_long_line_is_limited():
    assert len(dashes(np.array([[0.0, 0.0], [1e5, 0.0]]), most=50)) == 50


# ---- what the robot perceives -----------------------------------------------------------------


@pytest.fixture
def perceiving(stage):
    """Return a stage that shows something in each layer."""
    perceived = stage.state.perceived
    pixels, _ = map_pixels(np.zeros((4, 6), dtype=np.int8))
    perceived.map = map_image(pixels, 0.5, np.array([1.0, 2.0, 0.0]))
    perceived.update_scan("scan", np.array([[1.0, 0.0, 0.2], [2.0, 0.0, 0.2]]), 1.0)
    one = np.ones(1)
    perceived.update_tracks(Tracks(np.ones((1, 2)), np.ones((1, 2)), one, one, one), 1.0)
    perceived.contacts["a"] = Contact("a touches b", np.array([1.0, 2.0, 0.1]), 5.0, 1.0)
    start, end = np.array([[0.0, 0.0, 1.0]] * 2), np.array([[0.0, 0.0, 0.2], [0.8, 0.0, 1.0]])
    perceived.body = BodyView(start, end, np.array([0.1, 0.2]), np.zeros((1, 4, 2)), None)
    nearest = Nearest("platform", 0.5, np.array([[0.5, 0.0, 0.3], [1.0, 0.0, 0.3]]))
    perceived.update_plan(PlanView(np.array([[[0.0, 0.0, 0.3], [2.0, 1.0, 0.3]]]), nearest), 1.0)
    return stage


PARTS = {
    "map": ("map",),
    "scan": ("scan",),
    "tracked obstacles": ("track_arrows", "track_circles"),
    "contacts": ("contacts",),
    "plan of the body": ("plan_ghosts", "plan_nearest"),
    "shapes for distances": ("shapes/tubes", "shapes/balls", "shapes/footprint"),
}


def test_each_layer_can_be_switched_off_and_on(perceiving):
    stage, everything = perceiving, frozenset(LAYERS)
    for layers in (everything, *(everything - {layer} for layer in LAYERS), everything):
        stage.scene.draw_perceived(stage.state, layers)
        for name, parts in PARTS.items():
            assert [stage[part].visible for part in parts] == [name in layers] * len(parts)


def test_what_is_perceived_is_drawn_in_its_place_and_sent_once(perceiving, monkeypatch):
    stage = perceiving
    stage.scene.draw_perceived(stage.state, frozenset(LAYERS))
    assert stage["map"].position[:2] == pytest.approx([2.5, 3.0])
    assert (stage["map"].render_width, stage["map"].render_height) == (3.0, 2.0)
    assert stage["scan"].points.shape == (2, 3)
    assert stage["contacts"].batched_positions[0] == pytest.approx([1.0, 2.0, 0.1])
    tubes = stage["shapes/tubes"]
    assert tubes.batched_positions == pytest.approx(np.array([[0, 0, 0.6], [0.4, 0, 1.0]]))
    assert tubes.batched_scales[1] == pytest.approx([0.2, 0.2, 0.8])
    w, x, y, z = tubes.batched_wxyzs[1]
    along = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    assert along == pytest.approx((1.0, 0.0, 0.0), abs=1e-6), "its axis z points along the capsule"
    assert stage["plan_ghosts"].points == pytest.approx(stage.state.perceived.plan.ghosts)
    assert stage["plan_nearest"].points[0, 1] == pytest.approx([1.0, 0.0, 0.3])
    sent = []
    monkeypatch.setattr(stage.server.scene, "_queue_scene_message", sent.append)
    stage.scene.draw_perceived(stage.state, frozenset(LAYERS))
    assert sent == []
