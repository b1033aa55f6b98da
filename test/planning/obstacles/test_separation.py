import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.planning.obstacles import separation
from omniman_ros.planning.obstacles.separation import (
    box_gap,
    facing_gap,
    first_contact,
    outside_by,
    swept_gap,
    within_distance,
)
from omniman_ros.surroundings.ellipses import Ellipses
from test.work import calls

HALF = np.array([0.4, 0.25])
BOX = Rectangles.centred(HALF)
RADIUS = math.hypot(0.4, 0.25)
UNKNOWN = [math.nan, math.inf, -math.inf]


def gap(pose, center, axes, angle=0.0, half=HALF):
    """Return `box_gap` of one pose and one ellipse."""
    center, axes = np.array([[center]], dtype=float), np.array([[axes]], dtype=float)
    box, poses = Rectangles.centred(half), np.array([pose], dtype=float)
    result = box_gap(poses, box, center, axes, np.array([angle]))
    assert result.shape == (1, 1)
    return float(result[0, 0])


def in_box(poses, points):
    """Transform points (N, P, 2) into the frames of the boxes (N, 3)."""
    away = points - poses[:, None, :2]
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    return np.stack(
        [c * away[..., 0] + s * away[..., 1], c * away[..., 1] - s * away[..., 0]], axis=-1
    )


def corners(poses):
    """Return the corners (N, 4, 2) of the boxes in the world frame."""
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * HALF
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * signs[:, 0] - s * signs[:, 1]
    return np.stack([x, poses[:, 1:2] + s * signs[:, 0] + c * signs[:, 1]], axis=-1)


def sampled(poses, centers, axes, angles, points=720):
    """Return the sampled distance (N,) of N boxes to N ellipses; 0 where they overlap.

    Never less than the true distance.
    """
    phi = np.linspace(0, 2 * np.pi, points, endpoint=False)
    x, y = axes[:, :1] * np.cos(phi), axes[:, 1:] * np.sin(phi)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    boundary = centers[:, None] + np.stack([c * x - s * y, s * x + c * y], axis=-1)
    beyond = np.maximum(np.abs(in_box(poses, boundary)) - HALF, 0.0)
    distance = np.hypot(beyond[..., 0], beyond[..., 1]).min(axis=1)
    away = corners(poses) - centers[:, None]
    u = (c * away[..., 0] + s * away[..., 1]) / axes[:, :1]
    v = (c * away[..., 1] - s * away[..., 0]) / axes[:, 1:]
    return np.where((np.hypot(u, v) < 1).any(axis=1), 0.0, distance)


def cases(rng, count, aspect):
    """Draw poses (N, 3), centres (N, 2), axes (N, 2) of an aspect ratio, and angles (N,)."""
    poses = rng.uniform(-1, 1, (count, 3)) * [1, 1, 4]
    large = rng.uniform(0.1, 1.5, count)
    axes = np.stack([large, large / aspect], axis=1)
    return poses, rng.uniform(-3, 3, (count, 2)), axes, rng.uniform(-4, 4, count)


def gaps_of(poses, centers, axes, angles):
    """Return `box_gap` of N separate pairs."""
    return np.array([gap(*case) for case in zip(poses, centers, axes, angles, strict=True)])


def one(center, velocity=(0.0, 0), axes=(0.2, 0.2), angle=0.0, growth=0.0, start=0.0):
    return Ellipses(
        start,
        np.array([center], dtype=float),
        np.array([velocity], dtype=float),
        np.array([axes], dtype=float),
        np.array([angle]),
        np.array([growth]),
    )


def standing(times):
    return np.zeros((len(times), 3)), np.zeros((len(times), 3))


def crowd(rng, count, spread=3.0):
    return Ellipses(
        rng.uniform(-1, 1),
        rng.uniform(-spread, spread, (count, 2)),
        rng.uniform(-1, 1, (count, 2)),
        rng.uniform(0.05, 0.7, (count, 2)),
        rng.uniform(-4, 4, count),
        rng.uniform(0, 0.3, count),
    )


def accelerated(rng, dt, steps=200):
    """Return times, poses and velocities of a random motion at constant acceleration."""
    times = np.linspace(0, dt, steps + 1)
    start, rate, acceleration = rng.uniform(-1, 1, (3, 3)) * [
        [0.5, 0.5, 4],
        [1.2, 1.2, 3],
        [3, 3, 6],
    ]
    t = times[:, None]
    return times, start + rate * t + 0.5 * acceleration * t * t, rate + acceleration * t


def winding(count=101, duration=5.0):
    """Return a smooth motion with its exact velocities."""
    t = np.linspace(0, duration, count)
    poses = np.stack([2 * np.sin(t / 2), 0.5 * t, 0.3 * t], axis=1)
    return t, poses, np.stack([np.cos(t / 2), np.full(count, 0.5), np.full(count, 0.3)], axis=1)


# ---- box_gap ----------------------------------------------------------------------------------


def test_gap_to_a_circle_is_exact_outside():
    rng = np.random.default_rng(1)
    poses, centers, axes, angles = cases(rng, 2000, 1.0)
    beyond = np.maximum(np.abs(in_box(poses, centers[:, None])[:, 0]) - HALF, 0.0)
    distance = np.hypot(*beyond.T)
    gaps = gaps_of(poses, centers, axes, angles)
    outside = distance > 0
    assert outside.sum() > 1500
    np.testing.assert_allclose(gaps[outside], (distance - axes[:, 0])[outside], atol=1e-12)
    assert (gaps[~outside] <= -axes[~outside, 0]).all()


@pytest.mark.parametrize(
    ("center", "expected"),
    [((1.0, 0.0), 0.4), ((-1.0, 0.1), 0.4), ((0.1, 0.75), 0.3), ((0.7, -0.65), 0.3)],
)
def test_gap_to_a_circle_next_to_edges_and_corners(center, expected):
    assert gap((0, 0, 0), center, (0.2, 0.2)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("axes", "angle", "expected"),
    [((1.0, 0.1), 0.0, 0.6), ((1.0, 0.1), math.pi / 2, 1.5), ((0.1, 1.0), math.pi / 2, 0.6)],
)
def test_gap_along_an_axis_of_the_ellipse_is_exact(axes, angle, expected):
    assert gap((0, 0, 0), (2, 0), axes, angle) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("aspect", "least", "median"),
    [(1.0, 0.99, 0.99), (2.0, 0.79, 0.95), (4.0, 0.46, 0.9), (10.0, 0.19, 0.88)],
)
def test_gap_is_a_tight_lower_bound_of_the_distance(aspect, least, median):
    rng = np.random.default_rng(2)
    poses, centers, axes, angles = cases(rng, 1500, aspect)
    distance = sampled(poses, centers, axes, angles)
    gaps = gaps_of(poses, centers, axes, angles)
    assert (gaps <= distance + 1e-12).all()
    far = distance > 0.05
    assert far.sum() > 1000
    ratio = gaps[far] / distance[far]
    assert ratio.min() > least  # (a / b + b / a) / 2 is the largest ratio of distance to bound
    assert np.median(ratio) > median


def test_gap_is_positive_exactly_where_box_and_ellipse_are_apart():
    rng = np.random.default_rng(3)
    poses, centers, axes, angles = cases(rng, 3000, 3.0)
    distance = sampled(poses, centers * 0.4, axes, angles)
    gaps = gaps_of(poses, centers * 0.4, axes, angles)
    sure = (distance == 0) | (distance > 1e-3)  # the rest is too close for the samples to decide
    assert 500 < (distance[sure] == 0).sum() < 2900
    np.testing.assert_array_equal((gaps > 0)[sure], (distance > 0)[sure])


@pytest.mark.parametrize("theta", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("center", [(0.0, 0.0), (0.1, -0.08)])
def test_gap_is_not_positive_with_the_obstacle_inside_the_box(theta, center):
    assert gap((0, 0, theta), center, (0.05, 0.02), 0.3) < 0


@pytest.mark.parametrize("theta", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("center", [(0.0, 0.0), (0.6, -0.7)])
def test_gap_is_not_positive_with_the_box_inside_the_obstacle(theta, center):
    assert gap((0, 0, theta), center, (2.0, 1.6), 0.3) < 0


def test_gap_decreases_continuously_to_the_centre_of_the_obstacle():
    x = np.linspace(2, 0, 201)
    depths = [gap((0, 0, 0), (d, 0.0), (0.5, 0.3)) for d in x]
    assert (np.diff(depths)[:-50] < 0).all()
    assert np.abs(np.diff(depths)).max() < 0.011  # no jumps: 10 mm a step


def test_gap_is_invariant_to_a_half_turn_and_to_mirroring():
    """No edge or corner is special: symmetries that swap corners keep the gap."""
    rng = np.random.default_rng(4)
    for pose, center, axes, angle in zip(*cases(rng, 300, 2.5), strict=True):
        gap_here = gap(pose, center, axes, angle)
        x, y, theta = pose
        assert gap((x, y, theta + math.pi), center, axes, angle) == pytest.approx(gap_here)
        assert gap(pose, center, axes, angle + math.pi) == pytest.approx(gap_here)
        assert gap(pose, center, axes[::-1], angle + math.pi / 2) == pytest.approx(gap_here)
        mirrored = gap((x, -y, -theta), center * [1, -1], axes, -angle)
        assert mirrored == pytest.approx(gap_here)
        turned = gap((x, y, theta + math.pi / 2), center, axes, angle, half=HALF[::-1])
        assert turned == pytest.approx(gap_here)


def test_result_has_one_row_per_pose_and_one_column_per_obstacle():
    rng = np.random.default_rng(5)
    poses, (_, centers, axes, angles) = rng.uniform(-1, 1, (3, 3)), cases(rng, 4, 2.0)
    moved = centers + np.array([0.0, 0.1, 0.3])[:, None, None]
    grown = axes * np.array([1.0, 1.1, 1.5])[:, None, None]
    gaps = box_gap(poses, BOX, moved, grown, angles)
    assert gaps.shape == (3, 4)
    for k in range(3):
        for m in range(4):
            single = gap(poses[k], moved[k, m], grown[k, m], angles[m])
            assert gaps[k, m] == pytest.approx(single, abs=1e-12)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("value", UNKNOWN)
@pytest.mark.filterwarnings("error")
def test_gap_of_a_pose_with_nan_fails_every_comparison(column, value):
    pose = np.zeros(3)
    pose[column] = value
    assert gap(pose, (5, 5), (0.2, 0.1)) == -math.inf


@pytest.mark.parametrize("value", UNKNOWN)
def test_obstacle_with_nan_has_no_gap(value):
    assert gap((0, 0, 0), (value, 5), (0.2, 0.1)) == -math.inf
    assert gap((0, 0, 0), (5, 5), (0.2, 0.1), angle=value) == -math.inf
    assert gap((0, 0, 0), (5, 5), (abs(value), 0.1)) == -math.inf


# ---- facing_gap -------------------------------------------------------------------------------


def facing(poses, centers, axes, angles, box=BOX):
    """Return `facing_gap` (N,) of N separate pairs."""
    pairs = zip(poses, centers, axes, angles, strict=True)
    return np.array(
        [
            facing_gap(pose[None], box, center[None, None], each[None, None], angle[None])[0, 0]
            for pose, center, each, angle in pairs
        ]
    )


@pytest.mark.parametrize(("aspect", "median"), [(1.0, 0.99), (2.0, 0.93), (4.0, 0.85)])
def test_facing_gap_is_a_lower_bound_of_the_distance(aspect, median):
    drawn = cases(np.random.default_rng(4), 1500, aspect)
    distance, gaps = sampled(*drawn), facing(*drawn)
    assert (gaps <= distance + 1e-12).all()
    far = distance > 0.05
    assert far.sum() > 1000 and np.median(gaps[far] / distance[far]) > median


def test_facing_gap_to_a_circle_is_that_of_any_box():
    rng = np.random.default_rng(5)
    poses, centers, axes, angles = cases(rng, 300, 1.0)
    box = Rectangles(np.array([0.2, -0.1]), np.array(0.6), HALF)
    pairs = zip(poses, centers, axes, angles, strict=True)
    exact = np.array(
        [
            box_gap(pose[None], box, center[None, None], each[None, None], angle[None])[0, 0]
            for pose, center, each, angle in pairs
        ]
    )
    found = facing(poses, centers, axes, angles, box)
    apart = exact > -axes[:, 0]
    np.testing.assert_allclose(found[apart], exact[apart], atol=1e-12)
    np.testing.assert_allclose(found[~apart], -axes[~apart, 0])


@pytest.mark.parametrize("value", UNKNOWN)
@pytest.mark.filterwarnings("error")
def test_facing_gap_of_what_is_not_finite_fails_every_comparison(value):
    usual = np.zeros(3), np.array([5.0, 5.0]), np.array([0.2, 0.1]), np.array(0.0)
    for k, number in enumerate(usual):
        changed = [np.array(each) for each in usual]
        changed[k] = np.full(number.shape, abs(value) if k == 2 else value)
        assert facing(*(each[None] for each in changed))[0] == -math.inf


# ---- swept_gap --------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.02, 0.1, 0.4])
def test_swept_gap_is_a_lower_bound_along_the_motion(dt):
    rng = np.random.default_rng(6)
    below = 0
    for _ in range(150):
        times, poses, velocities = accelerated(rng, dt)
        ellipses = crowd(rng, 10, spread=1.6)
        margin = rng.uniform(0, 0.1)
        ends = [0, -1]
        bound = swept_gap(times[ends], poses[ends], velocities[ends], BOX, ellipses, margin)
        assert bound.shape == (1, 10)
        centers, axes = ellipses.centers_at(times), ellipses.axes_at(times, margin)
        dense = box_gap(poses, BOX, centers, axes, ellipses.angles)
        # The gap itself is only a lower bound: where it is positive, the distance decides.
        closest = dense.argmin(axis=0)
        distance = sampled(
            poses[closest],
            centers[closest, range(10)],
            axes[closest, range(10)],
            ellipses.angles,
            360,
        )
        least = np.where(dense.min(axis=0) > 0, distance, dense.min(axis=0))
        assert (bound[0] <= least + 1e-9).all()
        below += int((bound[0] > 0).sum())
    assert below > 100  # the bound is useful: it proves many motions free


@pytest.mark.parametrize(("dt", "fraction", "loss"), [(0.02, 0.03, 0.001), (0.05, 0.05, 0.004)])
def test_few_close_passes_are_reported_as_contact(dt, fraction, loss):
    rng = np.random.default_rng(7)
    lost, free = [], 0
    for _ in range(300):
        times, poses, velocities = accelerated(rng, dt, steps=40)
        ellipses = crowd(rng, 10, spread=1.3)
        axes = ellipses.axes_at(times)
        dense = box_gap(poses, BOX, ellipses.centers_at(times), axes, ellipses.angles)
        ends = [0, -1]
        bound = swept_gap(times[ends], poses[ends], velocities[ends], BOX, ellipses)[0]
        least = dense.min(axis=0)
        near = (least > 0) & (least < 0.3)
        free += int(near.sum())
        lost.extend(zip((least - bound)[near], (bound <= 0)[near], strict=True))
    losses, alarms = np.array(lost).T
    assert free > 300
    assert np.median(losses) < loss
    assert alarms.mean() < fraction


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.6])
def test_obstacle_that_crosses_the_box_between_two_samples_is_found(offset):
    times = np.array([0.0, 0.5, 1.0])
    poses, velocities = standing(times)
    # The obstacle is 2 m in front of the box at 0.5 s and 2 m behind it at 1 s.
    bullet = one((-6 + offset, 0.1), velocity=(8.0, 0), axes=(0.02, 0.01))
    axes = bullet.axes_at(times)
    assert (box_gap(poses, BOX, bullet.centers_at(times), axes, bullet.angles) > 0.9).all()
    gaps = swept_gap(times, poses, velocities, BOX, bullet)[:, 0]
    assert gaps[0] > 0
    assert gaps[1] <= 0
    assert first_contact(times, poses, velocities, BOX, bullet) == 0.5


def test_box_that_passes_an_obstacle_between_two_samples_is_found():
    times = np.array([0.0, 1.0])
    poses = np.array([[-2.0, 0, 0], [2, 0, 0]])
    velocities = np.array([[4.0, 0, 0], [4, 0, 0]])
    assert swept_gap(times, poses, velocities, BOX, one((0, 0.1), axes=(0.05, 0.05)))[0, 0] <= 0


def test_corner_that_rotates_through_an_obstacle_between_two_samples_is_found():
    """The box is clear at both headings, half a turn apart, but not in between."""
    times, post = np.array([0.0, 1.0]), one((0, 0.4), axes=(0.05, 0.05))
    poses, velocities = np.zeros((2, 3)), np.zeros((2, 3))
    poses[1, 2] = velocities[:, 2] = math.pi
    axes = post.axes_at(times)
    assert (box_gap(poses, BOX, post.centers_at(times), axes, post.angles) > 0.09).all()
    assert swept_gap(times, poses, velocities, BOX, post)[0, 0] <= 0


def test_move_forth_and_back_between_two_samples_is_found():
    """The box is at the same place at 0 s and 1 s, but 0.25 m nearer in between."""
    times = np.array([0.0, 1.0])
    poses, velocities = np.zeros((2, 3)), np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    wall = one((0.8, 0.0), axes=(0.2, 0.2))  # 0.2 m ahead of the box
    assert swept_gap(times, poses, velocities, BOX, wall)[0, 0] <= 0


def test_close_drive_along_a_wall_is_free():
    times = np.linspace(0, 1, 11)
    poses, velocities = standing(times)
    poses[:, 0], velocities[:, 0] = 1.5 * times - 0.75, 1.5
    wall = one((0, 0.36), axes=(40.0, 0.1))
    gaps = swept_gap(times, poses, velocities, BOX, wall)  # 10 mm from the wall, 150 mm per step
    assert gaps.min() > 0.009


def test_swept_gap_at_rest_equals_the_gap():
    times = np.array([0.0, 0.1, 0.5])
    poses, velocities = standing(times)
    np.testing.assert_allclose(
        swept_gap(times, poses, velocities, BOX, one((1, 0))), [[0.4], [0.4]], atol=1e-12
    )


def test_growth_and_margin_reduce_the_gap():
    times = np.array([0.0, 0.1, 0.5])
    poses, velocities = standing(times)
    growing = one((1, 0), growth=0.2)
    gaps = swept_gap(times, poses, velocities, BOX, growing, margin=0.05)[:, 0]
    np.testing.assert_allclose(gaps, [0.33, 0.25], atol=1e-12)  # at the ends of the intervals


def test_obstacle_has_its_final_size_for_the_whole_interval():
    times = np.array([0.0, 0.5])
    poses, velocities = standing(times)
    poses[1, 0], velocities[:, 0] = -0.05, -0.1  # the robot drives away: 0.4 m, then 0.35 m
    gaps = swept_gap(times, poses, velocities, BOX, one((1, 0), growth=0.2))
    np.testing.assert_allclose(gaps, [[0.3]], atol=1e-12)


def test_rotation_forth_and_back_between_two_samples_is_found():
    """Headings at 0 s and 1 s are equal; a turn of 0.1 rad between moves a corner 0.04 m."""
    times = np.array([0.0, 1.0])
    poses, velocities = np.zeros((2, 3)), np.array([[0.0, 0, 0.4], [0, 0, -0.4]])
    post = one((0.4, 0.47), axes=(0.2, 0.2))  # 0.02 m from that corner
    assert swept_gap(times, poses, velocities, BOX, post)[0, 0] <= 0


def test_swept_gap_never_exceeds_the_gaps_at_the_ends():
    """This also holds where poses and velocities contradict each other."""
    times, poses = np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [1.4, 0, 0]])
    gaps = swept_gap(times, poses, np.zeros((2, 3)), BOX, one((2, 0)))
    assert gaps[0, 0] <= 1e-12


@pytest.mark.parametrize("value", UNKNOWN)
@pytest.mark.parametrize("which", ["poses", "velocities"])
def test_swept_gap_with_nan_is_not_positive(which, value):
    times, poses, velocities = winding(5)
    {"poses": poses, "velocities": velocities}[which][2, 1] = value
    gaps = swept_gap(times, poses, velocities, BOX, one((50, 50)))[:, 0]
    assert (gaps[1:3] == -math.inf).all()
    assert (gaps[[0, 3]] > 0).all()


@pytest.mark.parametrize(
    "times", [[], [0.0], [0.0, 0.0], [0.0, 2.0, 1.0], [0.0, math.nan, 1.0], [0.0, math.inf]]
)
@pytest.mark.parametrize("function", [swept_gap, within_distance, first_contact])
def test_times_that_do_not_increase_are_refused(function, times):
    times = np.array(times)
    with pytest.raises(InputError, match="times that increase are needed, got"):
        function(times, *standing(times), BOX, one((1, 0)))


# ---- first_contact, within_reach --------------------------------------------------------------


def test_first_contact_is_the_start_of_its_interval():
    times = np.linspace(3, 4, 11)
    poses, velocities = standing(times)
    poses[:, 0], velocities[:, 0] = times - 3, 1.0
    post = one((1.05, 0), start=3.0)  # touched after 0.45 m
    assert first_contact(times, poses, velocities, BOX, post) == pytest.approx(3.4)
    assert first_contact(times, poses, velocities, BOX, post, 0.1) == pytest.approx(3.3)


def test_earliest_of_several_contacts_counts():
    times, poses, velocities = winding()
    both = Ellipses(
        0.0, poses[[80, 40], :2], np.zeros((2, 2)), np.full((2, 2), 0.1), np.zeros(2), np.zeros(2)
    )
    contacts = [
        first_contact(times, poses, velocities, BOX, both.select(np.array(i)))
        for i in ([0], [1], [0, 1])
    ]
    assert contacts[1] < contacts[0] < math.inf
    assert contacts[2] == contacts[1]


@pytest.mark.parametrize("ellipses", [Ellipses.none(), one((40, 40))], ids=["none", "far"])
def test_no_contact_without_a_near_obstacle(ellipses):
    times, poses, velocities = winding()
    assert first_contact(times, poses, velocities, BOX, ellipses) == math.inf


def test_results_without_obstacles_have_zero_length_axes():
    times, poses, velocities = winding(5)
    none = Ellipses.none()
    assert swept_gap(times, poses, velocities, BOX, none).shape == (4, 0)
    assert within_distance(times, poses, velocities, BOX, none).shape == (0,)
    assert box_gap(poses, BOX, none.centers_at(times), none.axes_at(times), none.angles).shape == (
        5,
        0,
    )


@pytest.mark.parametrize(("bad", "contact"), [(0, 0), (1, 0), (2, 1), (50, 49), (100, 99)])
@pytest.mark.parametrize("which", ["poses", "velocities"])
@pytest.mark.parametrize("ellipses", [Ellipses.none(), one((40, 40))], ids=["none", "far"])
def test_pose_or_velocity_with_nan_is_a_contact(ellipses, which, bad, contact):
    for column in range(3):
        for value in UNKNOWN:
            times, poses, velocities = winding()
            {"poses": poses, "velocities": velocities}[which][bad, column] = value
            first = first_contact(times, poses, velocities, BOX, ellipses)
            assert first == times[contact]


def test_contact_before_a_pose_with_nan_is_reported():
    times, poses, velocities = winding()
    post = one(poses[40, :2], axes=(0.1, 0.1))
    known = first_contact(times, poses, velocities, BOX, post)
    poses[60] = math.nan
    assert first_contact(times, poses, velocities, BOX, post) == known < times[40]


@pytest.mark.parametrize("field", ["centers", "velocities", "semi_axes", "growth"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.filterwarnings("ignore:invalid value")
def test_obstacle_with_nan_is_a_contact_at_once(field, value):
    times, poses, velocities = winding()
    ellipses = one((40, 40))
    ellipses = replace(ellipses, **{field: np.full_like(getattr(ellipses, field), value)})
    assert within_distance(times, poses, velocities, BOX, ellipses).all()
    assert first_contact(times, poses, velocities, BOX, ellipses) == times[0]


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("which", ["poses", "velocities"])
def test_every_obstacle_is_within_reach_of_a_box_with_nan(which, column):
    times, poses, velocities = winding()
    {"poses": poses, "velocities": velocities}[which][7, column] = math.nan
    assert within_distance(times, poses, velocities, BOX, one((40, 40))).all()


def test_obstacle_with_nan_angle_is_within_reach_if_near():
    times, poses, velocities = winding()
    assert first_contact(times, poses, velocities, BOX, one((1, 1), angle=math.nan)) == 0.0
    assert first_contact(times, poses, velocities, BOX, one((40, 40), angle=math.nan)) == math.inf


def test_only_obstacles_that_stay_clear_are_left_out():
    rng = np.random.default_rng(8)
    left_out = kept = 0
    for _ in range(40):
        times, poses, velocities = accelerated(rng, 2.0, steps=200)
        ellipses = crowd(rng, 50, spread=8.0)
        margin = rng.uniform(0, 0.2)
        few = slice(None, None, 50)  # obstacles between the samples count too
        near = within_distance(times[few], poses[few], velocities[few], BOX, ellipses, margin)
        far = ellipses.select(~near)
        axes = far.axes_at(times, margin)
        gaps = box_gap(poses, BOX, far.centers_at(times), axes, far.angles)
        assert (gaps > 0).all()
        left_out, kept = left_out + len(far), kept + int(near.sum())
    assert left_out > 500
    assert kept > 200


def test_obstacle_that_moves_towards_the_box_is_within_reach():
    times = np.linspace(0, 4, 5)
    poses, velocities = standing(times)
    there = one((-10, 0), velocity=(5.0, 0))  # ends 10 m away after passing through the box
    past = one((-10, 3), velocity=(5.0, 0))
    away = one((-10, 0), velocity=(-5.0, 0))
    grown = one((-10, 0), growth=2.5)
    reached = [
        within_distance(times, poses, velocities, BOX, e).all() for e in (there, past, away, grown)
    ]
    assert reached == [True, False, False, True]


def test_box_that_moves_forth_and_back_between_samples_reaches_obstacles_there():
    times, poses = np.array([0.0, 1.0]), np.zeros((2, 3))
    velocities = np.array([[4.0, 0, 0], [-4.0, 0, 0]])  # 1 m forth and back
    post = one((1.5, 0), axes=(0.15, 0.15))
    assert within_distance(times, poses, velocities, BOX, post).all()
    assert first_contact(times, poses, velocities, BOX, post) == 0.0


def test_leaving_out_obstacles_beyond_reach_changes_no_contact():
    rng = np.random.default_rng(9)
    found = 0
    for _ in range(40):
        times, poses, velocities = winding(51)
        ellipses = crowd(rng, 30, spread=12.0)
        touched = ~(swept_gap(times, poses, velocities, BOX, ellipses) > 0).all(axis=1)
        expected = float(times[touched.argmax()]) if touched.any() else math.inf
        assert first_contact(times, poses, velocities, BOX, ellipses) == expected
        found += expected < math.inf
    assert 5 < found < 40


def test_of_ten_thousand_obstacles_only_those_near_are_checked_in_full(monkeypatch):
    motion = winding()
    ellipses = crowd(np.random.default_rng(10), 10_000, spread=100.0)
    checked = []

    def gap_of_each(times, poses, velocities, box, ellipses, margin):
        checked.append(len(ellipses))
        return swept_gap(times, poses, velocities, box, ellipses, margin)

    monkeypatch.setattr(separation, "swept_gap", gap_of_each)
    assert first_contact(*motion, BOX, ellipses) < math.inf
    [count] = checked
    assert 0 < count < 50
    # The choice itself is one of whole arrays.
    few = ellipses.select(np.arange(10_000) < 10)
    choice = calls(lambda: within_distance(*motion, BOX, ellipses))
    assert choice == calls(lambda: within_distance(*motion, BOX, few))


# ---- outside_by -------------------------------------------------------------------------------


def test_outside_by_is_the_distance_of_the_farthest_corner():
    rng = np.random.default_rng(11)
    poses = rng.uniform(-1, 1, (500, 3)) * [4, 3, 5]
    low, high = np.array([-3.0, -2.0]), np.array([3.5, 2.5])
    points = corners(poses)
    expected = np.maximum(low - points, points - high).max(axis=(1, 2))
    outside = outside_by(poses, BOX, (-3.0, -2.0, 3.5, 2.5))
    assert outside.shape == (500,)
    assert 100 < (outside > 0).sum() < 400
    np.testing.assert_allclose(outside, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((0, 0, 0), -1.6),
        ((0, 0, math.pi / 2), -1.6),
        ((1.9, 0, 0), 0.3),
        ((0, -1.85, 0), 0.1),
        ((0, 1.85, math.pi / 2), 0.25),
        ((0, 1.0, math.pi / 6), 1 + 0.25 * 3**0.5 / 2 + 0.2 - 2),
    ],
)
def test_outside_by_matches_values_computed_by_hand(pose, expected):
    outside = outside_by(np.array([pose], dtype=float), BOX, (-2.0, -2.0, 2.0, 2.0))
    assert outside[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("value", UNKNOWN)
@pytest.mark.filterwarnings("error")
def test_pose_with_nan_is_outside_in_every_comparison(column, value):
    poses = np.zeros((2, 3))
    poses[1, column] = value
    outside = outside_by(poses, BOX, (-2.0, -2.0, 2.0, 2.0))
    assert outside[1] == math.inf
    assert outside[0] < 0
