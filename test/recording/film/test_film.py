import math

import numpy as np
import pytest

pytest.importorskip("PIL")

from omniman_ros.cli.urdf import robot_description
from omniman_ros.recording.film.film import Film, FilmFormat
from omniman_ros.recording.film.film_log import Solid
from omniman_ros.recording.film.picture import FLOOR
from omniman_ros.recording.film.shots import Shot, cut
from omniman_ros.viewer import style
from test.recording.film.logs import log_of, series

FORMAT = FilmFormat((160, 90), 2.0)
ROBOT = robot_description("omniman")
MARGIN = 14  #: Rows of captions at the upper and the lower edge of these small pictures


def film_of(log, shots):
    return Film(log, shots, ROBOT.robot, ROBOT.mount, FORMAT)


def frames_of(log, shots):
    return [np.asarray(frame).astype(int) for frame in film_of(log, shots).frames()]


def middle_of(mask):
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


def is_like(image, colour, tolerance=40):
    """Return which pixels have the hue of a colour, however bright they are."""
    wanted = np.array(colour) / np.linalg.norm(colour)
    length = np.maximum(np.linalg.norm(image, axis=-1), 1.0)
    return (image @ wanted / length > 0.985) & (length > tolerance)


def person(x, y):
    return Solid(True, (x, y, 0.0), (0.5, 0.5), (0.0, 1.7))


def test_there_are_as_many_frames_as_the_shots_take_all_of_one_size():
    log = log_of([(0.0, "cmd_vel"), (6.0, "none")], 8.0)
    shots = [Shot("cmd_vel", 0.0, 2.0, 2.0), Shot("cmd_vel", 4.0, 6.0, 1.0)]
    frames = frames_of(log, shots)
    assert len(frames) == film_of(log, shots).frame_count == 2 + 4
    assert {frame.shape for frame in frames} == {(90, 160, 3)}


def test_the_robot_drives_through_a_picture_that_stands_still():
    log = log_of([(0.0, "cmd_vel"), (6.0, "none")], 6.0)
    frames = frames_of(log, [Shot("cmd_vel", 0.0, 6.0, 3.0)])
    decks = [
        middle_of((np.abs(frame - FLOOR).sum(axis=-1) > 90)[MARGIN:-MARGIN]) for frame in frames
    ]
    moves = np.diff(np.array(decks), axis=0)
    assert np.hypot(*moves.T).min() > 1.0
    # It goes straight on: all moves have one direction.
    assert (moves @ moves[0] > 0.0).all()


def test_the_arm_is_where_its_joints_are():
    log = log_of([(0.0, "cmd_vel"), (6.0, "none")], 6.0)
    stretched, folded = np.zeros(6), np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
    log.robot.arm = np.array(
        [[0.0, *stretched], [3.0, *stretched], [3.1, *folded], [6.0, *folded]]
    )
    film = film_of(log, [Shot("cmd_vel", 2.9, 3.2, 0.2)])
    assert film.joints(1.0) == pytest.approx(stretched)
    assert film.joints(3.05) == pytest.approx(0.5 * folded)
    first, *_, last = (np.asarray(frame).astype(int) for frame in film.frames())
    assert (np.abs(first - last).sum(axis=-1) > 60).sum() > 30


def test_persons_go_straight_on_between_two_reports_and_robots_truth_and_odometry_coincide():
    log = log_of(
        [(0.0, "cmd_vel"), (4.0, "none")],
        4.0,
        world=series((0.0, (person(1.0, 1.0),)), (4.0, (person(1.0, -3.0),))),
    )
    # Odometry believes to be 1 m farther to the left than the robot is, and turned by 90 degrees.
    log.robot.odom[:, 2] += 1.0
    log.robot.odom[:, 3] = 0.5 * math.pi
    film = film_of(log, [Shot("cmd_vel", 0.0, 4.0, 1.0)])
    [solid] = film._solids(2.0)
    x, y, _ = film.pose(2.0)
    # The person is 1 m to the right of the true robot, which is at x = 1 m and looks along x.
    assert solid.place[:2] == pytest.approx((x + 1.0, y))


def test_persons_are_seen_and_the_robot_through_them():
    sources = [(0.0, "cmd_vel"), (4.0, "none")]
    shots = [Shot("cmd_vel", 0.0, 1.0, 4.0)]
    [without] = frames_of(log_of(sources, 4.0), shots)
    standing = series((0.0, (person(0.3, 0.0),)))
    [with_person] = frames_of(log_of(sources, 4.0, world=standing), shots)
    changed = np.abs(with_person - without).sum(axis=-1) > 25
    assert changed.sum() > 100
    # Where the person hides the dark chassis, the picture is darker than the person alone.
    dark = without.sum(axis=-1) < 300
    assert (changed & dark).any()
    assert (with_person[changed & dark].sum(axis=-1) < 600).all()


def test_without_a_world_the_obstacles_are_the_bodies():
    log = log_of([(0.0, "mpc")], 4.0, obstacles=series((0.0, (person(2.0, 1.0),))))
    film = film_of(log, [Shot("mpc", 0.0, 4.0, 1.0)])
    assert film._solids(1.0) == [person(2.0, 1.0)]


@pytest.mark.parametrize(
    ("kind", "field", "colour"),
    [
        ("path", "paths", style.PATH),
        ("mpc", "plans", style.PLAN),
        ("tool", "tool_paths", style.TOOL_PATH),
    ],
)
def test_what_the_robot_follows_is_drawn_in_its_colour(kind, field, colour):
    line = np.array([[-1.0, 0.9, 0.8], [3.0, 0.9, 0.8]])[:, : 3 if kind == "tool" else 2]
    shots = [Shot(kind, 1.0, 1.2, 1.0)]
    [without] = frames_of(log_of([(0.0, "path")], 6.0), shots)
    [drawn] = frames_of(log_of([(0.0, "path")], 6.0, **{field: series((0.9, line))}), shots)
    inner = np.s_[MARGIN:-MARGIN]
    assert is_like(drawn[inner], colour).sum() > is_like(without[inner], colour).sum() + 8


def test_a_stop_is_announced_from_the_moment_on_at_which_it_holds():
    log = log_of([(0.0, "cmd_vel"), (4.0, "stop"), (6.0, "none")], 8.0)
    log.stops["/platform_controller"] = series((0.0, ""), (4.0, "emergency_stop"), (6.0, ""))
    shots = [shot for shot in cut(log, 100.0) if shot.kind == "stop"]
    film = film_of(log, shots)
    texts = [film._caption(shots[0], time, 0.0).alarm for time in (3.9, 4.1, 5.9)]
    assert texts == ["", "stopped: emergency_stop", "stopped: emergency_stop"]
    frames = [np.asarray(frame).astype(int) for frame in film.frames()]
    banner = [is_like(frame[-8:-2], (201, 42, 42)).mean() > 0.5 for frame in frames]
    assert banner[0] is np.False_ and banner[-1] is np.True_


def test_wheels_without_torque_are_announced():
    log = log_of([(0.0, "path")], 8.0, dead_wheels=series((2.0, ("rear_left",)), (4.0, ())))
    film = film_of(log, [Shot("fault", 0.0, 8.0)])
    texts = [film._caption(Shot("fault", 0.0, 8.0), time, 0.0).alarm for time in (1.0, 3.0, 5.0)]
    assert texts == ["", "no torque: rear_left", ""]
