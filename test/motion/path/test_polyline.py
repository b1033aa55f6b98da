import itertools

import numpy as np
import pytest

from omniman_ros.motion.path import polyline

SCALE = np.array([0.01, 0.01, 0.02])


def test_headings_take_the_short_way_round_from_the_robots_heading():
    poses = np.array([[0, 0, 3.0], [1, 0, -3.0], [2, 0, 3.0]])
    assert polyline.unwrap_headings(poses, 9.0)[:, 2] == pytest.approx(
        [3.0 + 2 * np.pi, -3.0 + 4 * np.pi, 3.0 + 2 * np.pi]
    )


def test_repeated_points_are_omitted():
    poses = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0.5]], dtype=float)
    assert len(polyline.remove_repeats(poses, SCALE)) == 3


def test_points_on_a_straight_line_are_omitted():
    poses = np.linspace([0, 0, 0], [3, 1, 0.6], 1000)
    assert len(polyline.simplify(poses, SCALE)) == 2


@pytest.mark.parametrize("seed", range(10))
def test_no_omitted_point_deviates_by_more_than_the_scale(seed):
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(size=(300, 3)) * [0.02, 0.02, 0.02], axis=0)
    kept = polyline.simplify(poses, SCALE)
    assert 2 < len(kept) < len(poses)
    assert (kept[0] == poses[0]).all() and (kept[-1] == poses[-1]).all()
    at = [int(np.flatnonzero((poses == row).all(axis=1))[0]) for row in kept]
    assert at == sorted(at)
    for a, b in itertools.pairwise(at):
        chord = (poses[b] - poses[a]) / SCALE
        for point in (poses[a + 1 : b] - poses[a]) / SCALE:
            fraction = np.clip(point @ chord / (chord @ chord), 0, 1)
            assert np.abs(point - fraction * chord).max() <= 1.0 + 1e-9


def test_a_return_along_the_same_line_is_kept():
    poses = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [2, 0, 0]], dtype=float)
    assert len(polyline.simplify(poses, SCALE)) == 4


def test_a_closed_path_is_kept():
    phase = np.linspace(0, 2 * np.pi, 200)
    circle = np.column_stack([np.cos(phase), np.sin(phase), 0 * phase])
    assert len(polyline.simplify(circle, SCALE)) > 15


def test_repeated_poses_give_no_direction_of_travel():
    noise = 7.6e-6  # of single precision at 100 m
    poses = np.array([[0, 0, 9], [0, noise, 9], [2, 0, 9], [2 - noise, noise, 9]])
    rows = polyline.headings_along(poses, 0.2)
    assert rows[:, 2] == pytest.approx(0.0, abs=1e-4)
    assert rows[-1, :2].tolist() == [2 - noise, noise], "the path ends exactly at its last pose"
    dense = np.column_stack([np.arange(0, 0.1, 4e-5), np.zeros((2500, 2))])
    assert len(polyline.headings_along(dense, 0.2)) > 1000


def test_headings_along_the_path_turn_around_a_corner():
    poses = np.array([[0, 0, 9], [2, 0, 9], [2, 2, 9]], dtype=float)
    rows = polyline.headings_along(poses, 0.2)
    assert rows[:, 2] == pytest.approx([0, 0, np.pi / 2, np.pi / 2])
    assert rows[:, :2] == pytest.approx(np.array([[0, 0], [1.8, 0], [2, 0.2], [2, 2]]))


def test_headings_along_the_path_turn_in_place_without_spread():
    rows = polyline.headings_along(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], dtype=float), 0.0)
    assert rows[1, :2] == pytest.approx([1, 0]) and rows[2, :2] == pytest.approx([1, 0])


def test_headings_along_the_path_reach_its_end_and_never_unwind():
    phase = np.linspace(0, 4 * np.pi, 400)
    circle = np.column_stack([np.cos(phase), np.sin(phase), 0 * phase])
    rows = polyline.headings_along(circle, 0.2)
    assert (rows[[0, -1], :2] == circle[[0, -1], :2]).all()
    assert rows[-1, 2] - rows[0, 2] == pytest.approx(4 * np.pi, abs=0.1)
    assert (np.diff(rows[:, 2]) > -1e-9).all()


def test_headings_are_kept_along_a_path_that_stays_in_place():
    poses = np.array([[1, 1, 0], [1, 1, 2]], dtype=float)
    assert (polyline.headings_along(poses, 0.2) == poses).all()


@pytest.mark.parametrize(
    ("place", "first", "rest"),
    [
        ((0.5, 0.2), (0.5, 0, 0.5), 2),  # beside the first segment
        ((-1, 0), (0, 0, 0), 2),  # before the path
        ((1.0, 0.7), (1, 0.7, 1), 1),  # beside the second segment
        ((1, 9), (1, 1, 1), 0),  # beyond its end
    ],
)
def test_a_moving_robot_joins_where_the_path_comes_no_nearer(place, first, rest):
    poses = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1]], dtype=float)
    left = polyline.remaining_path(poses, np.array(place))
    assert left[0] == pytest.approx(first) and len(left) == 1 + rest
