"""The scene on a real server, without a browser: what it says to viser, and hears from hands."""

import asyncio
import contextlib
import io
import math
from types import SimpleNamespace

import numpy as np
import pytest

from omniman_ros.core.body.model import Mount
from omniman_ros.planning.cases import Turned
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.viewer.crowd import FASTEST, Crowd
from omniman_ros.viewer.dragging import FORGET, LINGER
from omniman_ros.viewer.events import (
    GoalDragged,
    ObstacleChosen,
    ObstacleDragged,
    ObstacleSent,
    StartDragged,
)
from omniman_ros.viewer.lines import outlines
from omniman_ros.viewer.state import Picture
from test import robots

viser = pytest.importorskip("viser", reason="viser is not installed (extra 'viewer')")

from omniman_ros.viewer.floor_scene import dashes, rectangle  # noqa: E402
from omniman_ros.viewer.page import free_port  # noqa: E402
from omniman_ros.viewer.scene import Scene  # noqa: E402
from omniman_ros.viewer.things import ARROWS, CHOSEN, PALE, PLACED, REST, SOLID  # noqa: E402

HOST = "127.0.0.1"
EYE = np.array([-3.0, 1.0, 2.5])
ARM = np.array([0.4, -1.1, 1.5, -0.4, 1.2, 0.0])


class Stage:
    """A scene, its picture and clock, what it has posted, and hands to drag with."""

    def __init__(self, mount=Mount(), name="omniman"):  # noqa: B008
        robot = robots.robot(name)
        self.robot = robot
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=HOST, port=free_port(HOST, 18280), verbose=False)
        self.clients = {7: SimpleNamespace(camera=SimpleNamespace(position=EYE))}
        self.server.get_clients = lambda: self.clients
        self.events, self.now = [], 100.0
        self.scene = Scene(self.server, robot, mount, self.events.append, lambda: self.now)
        self.picture = Picture(robot.wheel_count, robot.wheel_count - 3)
        self.crowd = Crowd()
        self.follow = False

    def close(self):
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __getitem__(self, name):
        return self.server.scene.get_handle_by_name(f"/world/{name}")

    def draw(self, lines=False):
        self.picture.crowd = self.crowd.rows(self.now)
        self.scene.draw(self.picture, self.follow)
        if lines:
            self.scene.draw_lines(self.picture)

    def say(self, name, phase, start, end, index=None):
        """What viser says of a drag; returns the events that came of it."""
        handle, posted = self[name], len(self.events)
        event = SimpleNamespace(
            client=SimpleNamespace(camera=SimpleNamespace(position=EYE)), client_id=7,
            target=handle, phase=phase, instance_index=index, start_position=tuple(start),
            end_position=tuple(end),
        )  # fmt: skip
        (entry,) = handle._impl.drag_cb
        assert asyncio.iscoroutinefunction(entry.callback), "others would come out of order"
        asyncio.run(entry.callback(event))
        return self.events[posted:]

    def drag(self, name, grabbed, to, index=None, end="end"):
        """Grab a point of a thing and lead it to another of the same height."""
        grabbed, to = np.array(grabbed, dtype=float), np.array(to, dtype=float)
        # The pointer is known on another plane, on the same ray.
        pointer = EYE + 0.8 * (to - EYE)
        assert self.say(name, "start", grabbed, grabbed, index) == []
        moved = self.say(name, "update", grabbed, pointer, index)
        return moved if end is None else moved + self.say(name, end, grabbed, pointer, index)


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


def test_the_arm_is_hidden_until_it_is_heard(stage):
    stage.draw()
    assert not stage["robot/arm"].visible
    still = stage["robot/arm/tubes"].batched_positions.copy()
    stage.picture.hear_arm(ARM, 1.0)
    stage.draw()
    assert stage["robot/arm"].visible
    moved = np.linalg.norm(stage["robot/arm/tubes"].batched_positions - still, axis=1)
    assert moved[0] == 0.0 and moved[-1] > 0.1, "the foot stands, the flange moves"


def test_a_robot_without_an_arm_shows_none(make_stage):
    stage = make_stage(mount=None)
    stage.picture.hear_arm(ARM, 1.0)
    stage.draw()
    assert stage["robot/arm"] is None


def test_what_does_not_change_is_not_sent_again(stage, monkeypatch):
    picture = stage.picture
    picture.hear_odom((1.0, 2.0, 0.3), 1.0)
    picture.hear_arm(ARM, 1.0)
    picture.goal = (1.0, 1.0, 0.0)
    picture.path.set(np.array([[0.0, 0.0], [1.0, 0.0]]))
    stage.crowd.add(Turned((1.0, 1.0)), stage.now)
    stage.follow = True
    stage.draw(lines=True)
    sent = []
    monkeypatch.setattr(stage.server.scene, "_queue_scene_message", sent.append)
    stage.draw(lines=True)
    assert sent == []
    picture.goal = (1.0, 1.1, 0.0)
    stage.draw(lines=True)
    assert [message.name for message in sent] == ["/world/goal"], "it is watched"


def test_start_and_goal_stand_where_the_picture_has_them(stage):
    stage.picture.start, stage.picture.goal = (1.0, 2.0, 0.5), (3.0, 0.0, -1.0)
    stage.draw()
    assert stage["start"].visible and stage["start"].position == pytest.approx([1.0, 2.0, 0.0])
    assert stage["goal"].position == pytest.approx([3.0, 0.0, 0.0])
    assert stage["goal"].wxyz == pytest.approx([math.cos(-0.5), 0.0, 0.0, math.sin(-0.5)])
    stage.picture.start = None
    stage.draw()
    assert not stage["start"].visible


def test_a_goal_that_is_not_set_waits_palely_ahead_of_the_robot(stage):
    stage.draw()
    assert not stage["goal"].visible, "nobody knows where the robot is"
    stage.picture.hear_odom((1.0, 2.0, math.pi / 2), 1.0)
    stage.draw()
    goal = stage["goal"]
    assert goal.visible and stage["goal/border"].opacity == PALE
    assert goal.position[0] == pytest.approx(1.0)
    assert goal.position[1] > 2.0 + stage.robot.body.length, "it does not overlap the robot"
    stage.picture.goal = (5.0, 0.0, 0.0)
    stage.draw()
    assert stage["goal/border"].opacity == SOLID and goal.position[0] == 5.0


@pytest.mark.parametrize(
    ("name", "kind"), [("goal", GoalDragged), ("start", StartDragged)], ids=["goal", "start"]
)
def test_a_dragged_plate_moves_the_marker_and_keeps_its_heading(stage, name, kind):
    setattr(stage.picture, name, (2.0, 1.0, 0.7))
    stage.draw()
    said = stage.drag(f"{name}/plate", (2.2, 0.9, 0.01), (3.2, 0.4, 0.01))
    assert [type(event) for event in said] == [kind, kind]
    assert [event.done for event in said] == [False, True]
    for event in said:
        assert event.pose == pytest.approx((3.0, 0.5, 0.7))


def test_a_dragged_knob_turns_the_marker_about_its_middle(stage):
    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    tip = stage["goal/knob"].vertices[:, 0].mean()
    # Grabbed off its centre, and led a quarter turn round.
    grabbed, to = (2.0 + tip + 0.03, 1.02, 0.05), (2.03, 1.02 + tip, 0.05)
    (_, last) = stage.drag("goal/knob", grabbed, to)
    assert last.done and last.pose == pytest.approx((2.0, 1.0, math.pi / 2), abs=1e-6)


def test_what_is_dragged_follows_the_hand_before_the_picture_knows(stage):
    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    assert stage["goal"].position == pytest.approx([3.0, 1.0, 0.0])


def test_what_was_let_go_is_where_the_picture_has_it(stage):
    stage.picture.start = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("start/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01))
    stage.draw()
    stage.now += LINGER
    stage.draw()
    assert stage["start"].position == pytest.approx([2.0, 1.0, 0.0]), "refused"


def test_a_browser_that_stalls_lets_go_and_sends_nothing_off(stage):
    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    stage.now += FORGET
    stage.draw()
    assert stage["goal"].position == pytest.approx([2.0, 1.0, 0.0])
    assert [event.done for event in stage.events] == [False]


def test_a_hand_that_has_rested_goes_on_where_it_was(stage):
    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.draw()
    stage.now += 2 * FORGET
    stage.draw()
    pointer = EYE + 0.8 * (np.array([3.0, 1.0, 0.01]) - EYE)
    (last,) = stage.say("goal/plate", "end", (0, 0, 0), pointer)
    assert last.done and last.pose == pytest.approx((3.0, 1.0, 0.0))


def test_a_browser_that_is_lost_does_not_send_the_goal(stage):
    """viser ends its drag as if it had been let go."""
    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.drag("goal/plate", (2.0, 1.0, 0.01), (3.0, 1.0, 0.01), end=None)
    stage.clients.clear()
    assert stage.say("goal/plate", "end", (0, 0, 0), (3.0, 1.0, 0.01)) == []
    assert stage.say("goal/plate", "update", (0, 0, 0), (4.0, 1.0, 0.01)) == [], "not held"


def test_the_hand_is_on_the_floor_that_follows_the_robot(stage):
    stage.picture.hear_odom((10.0, -4.0, 0.0), 1.0)
    stage.picture.goal = (12.0, -3.0, 0.0)
    stage.follow = True
    stage.draw()
    assert stage.server.scene.get_handle_by_name("/world").position[:2].tolist() == [-10.0, 4.0]
    said = stage.drag("goal/plate", (2.0, 1.0, 0.01), (2.5, 0.0, 0.01))
    assert said[-1].pose == pytest.approx((12.5, -4.0, 0.0))
    stage.draw()
    stage.now += FORGET
    stage.draw()
    stage.say("goal/plate", "start", (2.0, 1.0, 0.01), (2.0, 1.0, 0.01))
    stage.picture.hear_odom((10.5, -4.0, 0.0), 2.0)
    stage.draw()
    (said,) = stage.say("goal/plate", "end", (0, 0, 0), (2.0, 1.0, 0.01))
    assert said.pose == pytest.approx((12.5, -3.0, 0.0)), "the floor has moved below the hand"


def test_a_camera_that_is_not_known_yet_moves_nothing(stage):
    class Unknown:
        @property
        def position(self):
            raise AssertionError

    stage.picture.goal = (2.0, 1.0, 0.0)
    stage.draw()
    stage.say("goal/plate", "start", (2.0, 1.0, 0.01), (2.0, 1.0, 0.01))
    (entry,) = stage["goal/plate"]._impl.drag_cb
    asyncio.run(
        entry.callback(
            SimpleNamespace(
                client=SimpleNamespace(camera=Unknown()), client_id=7, phase="end",
                target=stage["goal/plate"], end_position=(3.0, 1.0, 0.01),
            )
        )
    )  # fmt: skip
    assert stage.events == [GoalDragged((2.0, 1.0, 0.0), True)]


def test_obstacles_are_as_the_crowd_has_them(stage):
    stage.crowd.add(Turned((1.0, 2.0)), stage.now, (0.3, 0.2), 0.5)
    stage.crowd.add(Turned((3.0, -1.0)), stage.now)
    stage.picture.chosen = 1
    stage.draw()
    crowd = stage["crowd"]
    assert crowd.batched_positions == pytest.approx(np.array([[1, 2, 0], [3, -1, 0]]))
    assert crowd.batched_scales == pytest.approx(np.array([[0.3, 0.2, 1], [0.25, 0.25, 1]]))
    assert crowd.batched_wxyzs[0] == pytest.approx([math.cos(0.25), 0, 0, math.sin(0.25)])
    assert crowd.batched_colors.tolist() == [list(PLACED), list(CHOSEN)]


def test_any_number_of_obstacles_is_shown_by_one_batch(stage):
    stage.draw()
    crowd = stage["crowd"]
    assert not crowd.visible and not stage["crowd_arrows"].visible
    for count in (1, 3):
        stage.crowd.add(Turned((float(count), 0.0)), stage.now)
        stage.crowd.add(Turned((float(count), 1.0)), stage.now)
        stage.draw()
        for name in ("crowd", "crowd_arrows"):
            handle = stage[name]
            shapes = [
                getattr(handle, f"batched_{what}").shape
                for what in ("positions", "wxyzs", "scales", "colors")
            ]
            assert handle.visible and shapes == [(count + 1, k) for k in (3, 4, 3, 3)]
    stage.crowd.delete(None)
    stage.draw()
    assert not crowd.visible and stage["crowd"] is crowd


def test_a_dragged_obstacle_says_which_and_where(stage):
    stage.crowd.add(Turned((0.0, 0.0)), stage.now)
    number = stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.crowd.delete(0)
    stage.draw()
    said = stage.drag("crowd", (1.1, 0.4, 0.55), (1.6, 1.4, 0.55), index=0)
    assert said[-1] == ObstacleDragged(number, pytest.approx((1.5, 1.5)), True)
    assert not said[0].done
    stage.draw()
    assert stage["crowd"].batched_positions[0] == pytest.approx([1.5, 1.5, 0.0])
    assert stage["crowd_arrows"].batched_positions[0] == pytest.approx([1.5, 1.5, ARROWS])


def test_an_arrow_ends_where_its_obstacle_will_be_in_a_second(stage):
    stage.crowd.add(Turned((1.0, 0.5), (0.3, -0.4)), stage.now)
    for held in (False, True):
        (stage.crowd.hold if held else stage.crowd.go)(stage.now)
        stage.draw()
        arrows = stage["crowd_arrows"]
        assert arrows.batched_positions[0] == pytest.approx([1.3, 0.1, ARROWS])
        assert stage["crowd_shafts"].points[0, 1] == pytest.approx([1.3, 0.1, ARROWS])
        assert stage["crowd_shafts"].visible


def test_a_dragged_arrow_sends_its_obstacle_off(stage):
    stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.draw()
    assert not stage["crowd_shafts"].visible, "it stands"
    said = stage.drag("crowd_arrows", (1.05, 0.5, ARROWS), (1.45, 0.9, ARROWS), index=0)
    assert said == [ObstacleSent(0, pytest.approx((0.4, 0.4)))] * 2
    stage.draw()
    assert stage["crowd_arrows"].batched_positions[0] == pytest.approx([1.4, 0.9, ARROWS])


def test_an_arrow_that_is_dragged_home_stops_its_obstacle(stage):
    stage.crowd.add(Turned((1.0, 0.5), (0.5, 0.0)), stage.now)
    stage.draw()
    near = 1.0 + 0.5 * REST
    said = stage.drag("crowd_arrows", (1.5, 0.5, ARROWS), (near, 0.5, ARROWS), index=0)
    assert said[-1].velocity == (0.0, 0.0)


def test_no_arrow_asks_for_more_than_the_crowd_takes(stage):
    number = stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.draw()
    said = stage.drag("crowd_arrows", (1.0, 0.5, ARROWS), (9.0, -8.0, ARROWS), index=0)
    assert said[-1].velocity == (FASTEST, -FASTEST)
    stage.crowd.send(number, said[-1].velocity, stage.now)


def test_an_obstacle_that_is_deleted_while_it_is_held_takes_no_arrow(stage):
    stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.draw()
    stage.say("crowd_arrows", "start", (1.0, 0.5, ARROWS), (1.0, 0.5, ARROWS), 0)
    stage.crowd.delete(None)
    stage.draw()
    assert stage.say("crowd_arrows", "update", (0, 0, 0), (1.5, 0.5, ARROWS), 0) == []


def test_an_index_beyond_the_crowd_grabs_nothing(stage):
    stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.draw()
    for index in (None, 1):
        for name in ("crowd", "crowd_arrows"):
            assert stage.drag(name, (1.0, 0.5, 0.6), (1.5, 0.5, 0.6), index=index) == []


def test_a_clicked_obstacle_is_chosen(stage):
    stage.crowd.add(Turned((0.0, 0.0)), stage.now)
    stage.crowd.add(Turned((1.0, 0.5)), stage.now)
    stage.crowd.delete(0)
    stage.draw()
    (entry,) = stage["crowd"]._impl.click_cb
    for index in (0, 1, None):
        asyncio.run(entry.callback(SimpleNamespace(instance_index=index)))
    assert stage.events == [ObstacleChosen(1)]


def test_obstacles_of_others_are_shown_and_cannot_be_dragged(stage):
    centers, axes = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.3, 0.2], [0.1, 0.1]])
    stage.picture.seen = Ellipses(
        0.0, centers, np.zeros((2, 2)), axes, np.array([0.4, 0.0]), np.zeros(2)
    )
    stage.draw()
    seen = stage["seen"]
    assert seen.visible and seen.batched_positions[:, :2] == pytest.approx(centers)
    assert seen.batched_scales[:, :2] == pytest.approx(axes)
    assert seen._impl.drag_cb == []
    stage.picture.seen = Ellipses.none()
    stage.draw()
    assert not seen.visible


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


def test_what_comes_next_moves_with_every_frame(stage):
    stage.picture.hear_plan(np.array([[0.0, 0.0], [1.0, 0.5]]), 1.0)
    stage.picture.hear_reference(np.array([[0.0, 0.0], [0.5, 0.0]]), 1.0)
    stage.scene.draw(stage.picture, False)
    for name in ("plan", "reference"):
        handle = stage.server.scene.get_handle_by_name(f"/world/{name}")
        assert handle.visible and len(handle.points) == 1


def test_lines_are_broken_where_they_are_to_be(stage):
    stage.picture.predicted.set(
        outlines(np.array([[0.0, 0.0], [5.0, 0.0]]), np.full((2, 2), 0.3), np.zeros(2))
    )
    stage.draw(lines=True)
    lengths = np.linalg.norm(np.diff(stage["predicted"].points, axis=1), axis=2)
    assert len(lengths) == 48 and lengths.max() < 0.1, "no piece leads to the next outline"


def test_the_path_of_the_tool_hangs_in_space(stage):
    points = np.array([[0.0, 0.0, 0.8], [0.5, 0.0, 1.0], [1.0, 0.5, 1.2]])
    stage.picture.tool_path.set(points)
    stage.draw(lines=True)
    assert stage["tool_path"].points[:, 0] == pytest.approx(points[:-1])
    assert stage["tool_path"].points[:, 1] == pytest.approx(points[1:])
    stage.picture.tool_path.set(points[:0])
    stage.draw(lines=True)
    assert not stage["tool_path"].visible


def test_a_workspace_is_shown_if_it_is_one(stage):
    for bounds, shown in (
        (None, False), ((-1.0, -2.0, 3.0, 4.0), True), ((-1e3, -2.0, 1e3, 4.0), False),
        ((-1.0, -1e3, 3.0, 1e3), False), ((-5.0, -2.0, 3.0, 4.0), True), (None, False),
    ):  # fmt: skip
        stage.picture.workspace = bounds
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
def test_a_line_of_no_length_has_no_dashes(count):
    assert dashes(np.zeros((count, 2))).shape == (0, 2, 2)


def test_a_long_line_has_not_more_dashes_than_can_be_drawn():
    assert len(dashes(np.array([[0.0, 0.0], [1e5, 0.0]]), most=50)) == 50
