import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.lab.studies.scene_geometry import (
    Ellipse,
    PolylineMotion,
    RectangularOutline,
    WallRectangle,
    ellipse_gaps,
    judge,
    outside,
    wall_gap,
)

BOX = RectangularOutline(0.8, 0.5)
places = st.floats(-1.5, 1.5)
angles = st.floats(-math.pi, math.pi)
sizes = st.floats(0.05, 0.6)


def gap(pose, center, axes, angle=0.0):
    centers = np.array([[center]], dtype=float)
    gaps = ellipse_gaps(np.array([pose]), BOX, centers, np.array([axes]), np.array([angle]))
    return float(gaps[0, 0])


def gap_to(pose, wall):
    return float(wall_gap(np.array([pose]), BOX, wall.row)[0])


def from_box(points, pose, box=BOX):
    """Return distances of points (N, 2) to a box; zero inside."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    seen = (points - pose[:2]) @ np.array([[c, -s], [s, c]])
    return np.hypot(*np.maximum(np.abs(seen) - box.half, 0.0).T)


def ellipse_points(center, axes, angle, count=4000):
    at = np.arange(count) * math.tau / count
    x, y = axes[0] * np.cos(at), axes[1] * np.sin(at)
    c, s = math.cos(angle), math.sin(angle)
    return np.stack((center[0] + c * x - s * y, center[1] + s * x + c * y), axis=1)


def edge_points(pose, box, count=400):
    fraction = np.linspace(-1.0, 1.0, count)
    i, j = box.half
    one = np.ones(count)
    edges = np.concatenate(
        [
            np.stack(p, axis=1)
            for p in (
                (i * fraction, j * one),
                (i * fraction, -j * one),
                (i * one, j * fraction),
                (-i * one, j * fraction),
            )
        ]
    )
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[:2] + edges @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_gap_of_a_rotated_box_to_a_disc_is_exact_at_edges_and_corners(heading):
    c, s = math.cos(heading), math.sin(heading)

    def seen(ahead, left):
        center = (1.0 + c * ahead - s * left, 2.0 + s * ahead + c * left)
        return gap((1.0, 2.0, heading), center, (0.3, 0.3))

    assert seen(0.9, 0.2) == pytest.approx(0.2, abs=1e-12)
    assert seen(-0.3, -0.75) == pytest.approx(0.2, abs=1e-12)
    assert seen(0.4 + 0.3, 0.25 + 0.4) == pytest.approx(0.2, abs=1e-12)
    assert seen(0.6, 0.0) == pytest.approx(-0.1, abs=1e-12)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(places, places, angles, sizes, sizes, angles)
def test_gap_to_an_ellipse_is_the_distance_of_its_nearest_point(x, y, heading, a, b, angle):
    pose, points = (x, y, heading), ellipse_points((0.0, 0.0), (a, b), angle)
    apart = from_box(points, pose).min()
    c, s = math.cos(angle), math.sin(angle)
    inside = ((c * x + s * y) / a) ** 2 + ((c * y - s * x) / b) ** 2 <= 1.0
    got = gap(pose, (0.0, 0.0), (a, b), angle)
    if inside or apart == 0.0:
        assert got <= 1e-12
    else:
        assert apart - 1e-4 <= got <= apart + 1e-12


@settings(max_examples=150, deadline=None, derandomize=True)
@given(places, places, angles, st.floats(0.02, 2.0), st.floats(0.02, 2.0), angles)
def test_gap_to_a_wall_is_the_distance_of_its_nearest_point(x, y, heading, length, width, angle):
    pose, wall = (x, y, heading), WallRectangle(0.0, 0.0, angle, length, width)
    there = (0.0, 0.0, angle)
    apart = min(
        from_box(edge_points(there, RectangularOutline(length, width)), pose).min(),
        from_box(edge_points(pose, BOX), there, RectangularOutline(length, width)).min(),
    )
    got = gap_to(pose, wall)
    if apart == 0.0:
        assert got <= 1e-12
    else:
        assert apart - 1e-2 <= got <= apart + 1e-12
        assert got > 0.0


def test_leaving_an_area_is_judged_by_the_farthest_corner():
    poses = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2), (0.7, 0.0, 0.0), (0, 0, 0.5)])
    reach = 0.4 * math.cos(0.5) + 0.25 * math.sin(0.5)
    assert outside(poses, BOX, (-1, -1, 1, 1)) == pytest.approx([-0.6, -0.6, 0.1, reach - 1.0])


def disc(radius, x, y, velocity=(0.0, 0.0)):
    return Ellipse((radius, radius), PolylineMotion.straight((x, y), velocity))


def standing(*obstacles, seconds=1.0, step=0.005):
    times = step * np.arange(round(seconds / step) + 1)
    return judge(times, np.zeros((len(times), 3)), BOX, obstacles)


def test_contact_is_at_the_arrival_of_the_first_disc():
    late, early = disc(0.5, 0.0, 3.0, (0.0, -3.0)), disc(0.3, 2.0, 0.1, (-2.0, 0.0))
    verdict = standing(late, early)
    assert verdict.contact == pytest.approx((2.0 - 0.7) / 2.0, abs=0.006)
    assert (verdict.touched, verdict.gap <= 0.0) == (1, True)


def test_robot_that_stops_short_has_no_contact_and_the_exact_gap():
    times = np.arange(0.0, 2.0, 0.005)
    poses = np.minimum(times, 1.0)[:, None] * [1.0, 0.0, 0.0]
    verdict = judge(times, poses, BOX, [disc(0.3, 1.75, 0.0)])
    assert (verdict.contact, verdict.touched) == (math.inf, None)
    assert verdict.gap == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize(("off", "collided"), [(-0.02, True), (0.001, True), (0.25, False)])
def test_fast_thin_disc_between_two_samples_is_a_contact_unless_its_way_excludes_one(
    off, collided
):
    """It passes a corner of the box by a distance, and travels 0.4 m between the samples."""
    out, along = np.array([1.0, 1.0]) / math.sqrt(2.0), np.array([-1.0, 1.0]) / math.sqrt(2.0)
    begin = np.array(BOX.half) + (0.01 + off) * out - 0.2 * along
    verdict = standing(disc(0.01, *begin, tuple(20.0 * along)), seconds=0.02, step=0.02)
    assert verdict.collided is collided


def test_heading_that_is_wrapped_does_not_spin_the_robot():
    poses = np.array([(0.0, 0.0, math.pi - 1e-3), (0.0, 0.0, -math.pi + 1e-3)])
    assert not judge(np.array([0.0, 0.005]), poses, BOX, [disc(0.1, 0.0, 0.4)]).collided


def test_outside_covers_the_whole_drive_and_nothing_is_touched_in_an_empty_world():
    poses = np.array([(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.0, 0.0, 0.0)])
    verdict = judge(np.arange(3.0), poses, BOX, [], (-1, -1, 1, 1))
    assert verdict.outside == pytest.approx(0.1)
    assert (verdict.gap, verdict.contact, verdict.collided) == (math.inf, math.inf, False)


@pytest.mark.parametrize("seed", range(6))
def test_no_contact_of_dense_sampling_escapes_the_judge(seed):
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.02, 0.05, 30))
    poses = np.cumsum(random.uniform(-0.05, 0.05, (30, 3)), axis=0)
    there = tuple(map(tuple, random.uniform(-2, 2, (2, 2))))
    axes, angle = tuple(random.uniform(0.05, 0.5, 2)), random.uniform(-3, 3)
    obstacle = Ellipse(axes, PolylineMotion((0.0, 1.0), there, (0.3, -0.5)), angle)
    dense = np.linspace(times[0], times[-1], 4001)
    between = np.stack([np.interp(dense, times, poses[:, i]) for i in range(3)], axis=1)
    centers = obstacle.place.at(dense)[:, None]
    gaps = ellipse_gaps(between, BOX, centers, np.array([axes]), np.array([angle]))[:, 0]
    verdict = judge(times, poses, BOX, [obstacle])
    assert verdict.gap >= gaps.min() - 2e-3 or verdict.collided
    if gaps.min() < 0.0:
        assert verdict.contact <= times[np.searchsorted(times, dense[np.argmax(gaps <= 0.0)])]


def test_route_is_clamped_before_its_start_and_goes_on_after_its_end():
    route = PolylineMotion((1.0, 2.0), ((0.0, 0.0), (2.0, 0.0)), (0.0, 1.0))
    at = route.at(np.array([0.0, 1.5, 2.0, 4.0]))
    assert at == pytest.approx(np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0)]))
    assert route.speed == 2.0
