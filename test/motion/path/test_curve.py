import numpy as np
import pytest

from omniman_ros.motion.path.curve import Curve
from test.motion.path.support import axes, random_path

GROUPS = axes()
TOLERANCES = [0.05, 0.1]


def rounded(points, room=TOLERANCES, groups=GROUPS, **options):
    return Curve(np.asarray(points, dtype=float), groups, room, **options)


def test_a_straight_line_is_one_piece_at_full_speed():
    curve = rounded([[0, 0, 0], [1, 0, 0]])
    assert curve.end == pytest.approx(1.0 / 0.5)
    assert curve.slope(np.array([0.0, 1.0]))[:, 0] == pytest.approx(0.5)
    assert len(curve.bends) == 1


def test_the_slower_of_position_and_heading_sets_the_parameter():
    assert rounded([[0, 0, 0], [0.1, 0, 1.2]]).end == pytest.approx(1.0)


def test_a_curve_begins_and_ends_exactly_at_the_end_points():
    for seed in range(20):
        points = random_path(seed)
        points = points[np.concatenate([[True], np.abs(np.diff(points, axis=0)).max(1) > 1e-6])]
        curve = rounded(points)
        assert curve.at(np.array([0.0, curve.end])) == pytest.approx(points[[0, -1]], abs=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_value_and_slope_are_continuous_and_the_second_derivative_is_consistent(seed):
    curve = rounded(random_path(seed, 8) + np.outer(np.arange(9), [0.05, 0, 0]))
    knots, tiny = curve.knots[1:-1], 1e-7
    for function in (curve.at, curve.slope):
        jump = function(knots + tiny) - function(knots - tiny)
        assert np.abs(jump).max() < 1e-4
    u = np.linspace(0.0, curve.end, 4001)
    numeric = np.gradient(curve.at(u), u, axis=0)
    assert np.abs(numeric - curve.slope(u))[2:-2].max() <= u[1] * np.abs(curve.bends).max() + 1e-9


@pytest.mark.parametrize("angle", [0.1, 1.0, np.pi / 2, 3.0, np.pi])
def test_a_corner_is_cut_by_at_most_its_tolerance(angle):
    room = 0.02
    points = [[0, 0, 0], [1, 0, 0], [1 + np.cos(angle), np.sin(angle), 0]]
    curve = rounded(points, [room, 0.1])
    corner = 1.0 / 0.5
    cut = np.hypot(*(curve.at(np.array([corner])) - points[1])[0, :2])
    turn = 2 * np.sin(angle / 2)
    full_speed = turn * 0.5 / (2 * 0.8) * turn * 0.5 / 4  # h |turn| / 4 at h = turn / (2 A)
    assert cut == pytest.approx(min(room, full_speed), rel=1e-6)


def test_parabolas_share_a_short_straight_segment():
    curve = rounded([[0, 0, 0], [1, 0, 0], [1, 0.01, 0], [2, 0.01, 0]])
    assert (np.diff(curve.knots) > 0).all()
    assert np.abs(curve.slope(curve.knots)[:, 1]).max() <= 0.5 + 1e-12


def test_the_first_corner_of_a_moving_robot_may_be_cut_freely():
    points = [[0, 0, 0], [0.2, 0, 0], [0.2, 1, 0]]
    tight = rounded(points, [1e-4, 0.1])
    free = rounded(points, [1e-4, 0.1], free_first_corner=True)
    assert np.abs(free.bends).max() < np.abs(tight.bends).max() / 10
    assert free.slope(np.zeros(1))[0] == pytest.approx([0.5, 0, 0])


def test_collinear_points_have_no_second_derivative():
    curve = rounded([[0, 0, 0], [1, 0, 0.1], [3, 0, 0.3]])
    assert np.abs(curve.bends).max() < 1e-9
