import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_gaps import ellipse_gap, outside, wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, Ellipse, PolylineMotion, Wall, World
from omniman_ros.lab.studies.scene_judge import CONTACT_GAP, judge

BOX = Box(0.8, 0.5)
TICK = 0.005
places = st.floats(-1.5, 1.5)
angles = st.floats(-math.pi, math.pi)
sizes = st.floats(0.05, 0.6)


def gap(pose, center, axes, angle=0.0):
    one = [np.array([values], dtype=float) for values in (pose, center, axes)]
    return float(ellipse_gap(one[0], BOX, one[1], one[2], np.array([angle]))[0])


def gap_to(pose, wall):
    return float(wall_gap(np.array([pose]), BOX, np.array([astuple(wall)]))[0])


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
    share = np.linspace(-1.0, 1.0, count)
    i, j = box.half
    one = np.ones(count)
    edges = np.concatenate(
        [
            np.stack(p, axis=1)
            for p in (
                (i * share, j * one),
                (i * share, -j * one),
                (i * one, j * share),
                (-i * one, j * share),
            )
        ]
    )
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[:2] + edges @ np.array([[c, s], [-s, c]])


# ---- one time -----------------------------------------------------------------------------------


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


def test_disc_within_the_box_and_a_box_within_a_disc_overlap():
    assert gap((0, 0, 0.3), (0.0, 0.0), (0.1, 0.1)) <= -0.25
    assert gap((0, 0, 0.3), (0.1, 0.0), (2.0, 2.0)) < 0.0


def test_gap_to_an_ellipse_along_its_axes_is_exact():
    assert gap((0, 0, 0), (1.0, 0.0), (0.5, 0.1)) == pytest.approx(0.1, abs=1e-12)
    assert gap((0, 0, 0), (1.0, 0.0), (0.5, 0.1), math.pi / 2) == pytest.approx(0.5, abs=1e-12)


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
    pose, wall = (x, y, heading), Wall(0.0, 0.0, angle, length, width)
    there = (0.0, 0.0, angle)
    apart = min(
        from_box(edge_points(there, Box(length, width)), pose).min(),
        from_box(edge_points(pose, BOX), there, Box(length, width)).min(),
    )
    got = gap_to(pose, wall)
    if apart == 0.0:
        assert got <= 1e-12
    else:
        assert apart - 1e-2 <= got <= apart + 1e-12
        assert got > 0.0


def test_gaps_to_a_wall_at_face_and_corner_are_exact():
    assert gap_to((0, 0, 0), Wall(1.0, 0.1, 0.0, 0.2, 3.0)) == pytest.approx(0.5)
    assert gap_to(
        (0, 0, 0), Wall(0.4 + 0.3 + 0.1, 0.25 + 0.4 + 0.1, 0.0, 0.2, 0.2)
    ) == pytest.approx(0.5)
    assert gap_to((0, 0, math.pi / 2), Wall(1.0, 0.0, 0.0, 0.5, 9.0)) == pytest.approx(0.5)
    assert gap_to((0, 0, 0), Wall(0.5, 0.0, 0.0, 0.4, 9.0)) == pytest.approx(-0.1)


def test_leaving_an_area_is_judged_by_the_farthest_corner():
    poses = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2), (0.7, 0.0, 0.0), (0, 0, 0.5)])
    reach = 0.4 * math.cos(0.5) + 0.25 * math.sin(0.5)
    assert outside(poses, BOX, (-1, -1, 1, 1)) == pytest.approx([-0.6, -0.6, 0.1, reach - 1.0])


# ---- over a drive -------------------------------------------------------------------------------


def standing(*bodies, seconds=1.0, pose=(0.0, 0.0, 0.0), step=TICK, since=0.0):
    times = since + step * np.arange(round(seconds / step) + 1)
    return judge(times, np.tile(pose, (len(times), 1)), BOX, world(*bodies))


def world(*bodies, area=None):
    ellipses = tuple(b for b in bodies if isinstance(b, Ellipse))
    return World(ellipses, tuple(b for b in bodies if isinstance(b, Wall)), area)


def disc(radius, x, y, velocity=(0.0, 0.0)):
    return Ellipse((radius, radius), PolylineMotion.straight((x, y), velocity))


def test_contact_is_at_the_arrival_of_the_disc():
    verdict = standing(disc(0.3, 2.0, 0.1, (-2.0, 0.0)))
    assert verdict.contact == pytest.approx((2.0 - 0.7) / 2.0, abs=CONTACT_GAP)
    assert verdict.touched == ("obstacle", 0)
    assert verdict.gap <= 0.0


def test_robot_that_stops_short_has_no_contact_and_the_exact_gap():
    times = np.arange(0.0, 2.0, TICK)
    xs = np.minimum(times, 1.0)
    poses = np.stack((xs, 0 * xs, 0 * xs), axis=1)
    verdict = judge(times, poses, BOX, world(disc(0.3, 1.75, 0.0)))
    assert (verdict.contact, verdict.touched) == (math.inf, None)
    assert verdict.gap == pytest.approx(0.05, abs=1e-9)
    assert verdict.gap_time == pytest.approx(1.0)


# A thin fast disc passes a corner of the box from the front to the side along a line that is
# offset from the corner by a distance (negative: through it), between two samples.
def past_corner(off, step=0.02, speed=20.0):
    out = np.array([1.0, 1.0]) / math.sqrt(2.0)
    nearest = np.array(BOX.half) + (0.01 + off) * out
    along = np.array([-1.0, 1.0]) / math.sqrt(2.0)
    begin = nearest - 0.5 * speed * step * along
    route = PolylineMotion.straight(tuple(begin.tolist()), tuple((speed * along).tolist()))
    return standing(Ellipse((0.01, 0.01), route), seconds=step, step=step)


def test_fast_thin_disc_that_crosses_a_corner_between_samples_is_found():
    verdict = past_corner(-0.02)
    assert verdict.collided
    # The disc enters through the front of the box and cuts 2 cm off the corner.
    assert 0.008 < verdict.contact < 0.01


def test_fast_thin_disc_that_misses_the_corner_between_samples_is_free():
    verdict = past_corner(0.001)
    assert not verdict.collided
    assert verdict.gap == pytest.approx(0.001, abs=CONTACT_GAP)
    assert verdict.gap_time == pytest.approx(0.01, abs=1e-3)


def test_obstacle_that_reverses_between_two_samples_is_found():
    def bouncing(x):
        return Ellipse(
            (0.3, 0.3), PolylineMotion((0.0, 0.1, 0.2), ((1.2, 0.0), (x, 0.0), (1.2, 0.0)))
        )

    assert standing(bouncing(0.69), seconds=0.2, step=0.2).contact == pytest.approx(0.1, abs=0.01)
    free = standing(bouncing(0.702), seconds=0.2, step=0.2)
    assert not free.collided and free.gap == pytest.approx(0.002, abs=CONTACT_GAP)


def test_corner_that_sweeps_across_between_two_samples_is_found():
    times = np.array([0.0, 0.1])
    poses = np.array([(0.0, 0.0, -0.3), (0.0, 0.0, 0.3)])
    edge = BOX.radius * np.array([math.cos(0.559), math.sin(0.559)])  # where a corner comes by
    at = edge * (1.0 + 0.04 / BOX.radius)
    swept = judge(times, poses, BOX, world(disc(0.05, *at)))
    assert swept.collided
    assert not judge(times[:1], poses[:1], BOX, world(disc(0.05, *at))).collided
    at = edge * (1.0 + 0.051 / BOX.radius)
    assert judge(times, poses, BOX, world(disc(0.05, *at))).gap == pytest.approx(0.001, abs=2e-4)


def test_first_contact_is_reported_and_not_the_deepest():
    late = disc(0.5, 0.0, 3.0, (0.0, -3.0))
    early = disc(0.1, 0.9, 0.0, (-0.7, 0.0))
    verdict = standing(late, early, Wall(0.0, -0.5, 0.0, 1.0, 0.4))
    assert verdict.touched == ("obstacle", 1)
    both = standing(late, Wall(0.0, -0.44, 0.0, 1.0, 0.4))
    assert (both.touched, both.contact) == (("wall", 0), 0.0)


def test_heading_that_is_wrapped_does_not_spin_the_robot():
    times = np.array([0.0, TICK])
    poses = np.array([(0.0, 0.0, math.pi - 1e-3), (0.0, 0.0, -math.pi + 1e-3)])
    assert not judge(times, poses, BOX, world(disc(0.1, 0.0, 0.4))).collided


def test_no_contact_in_an_empty_world():
    verdict = standing()
    assert (verdict.gap, verdict.contact, verdict.collided) == (math.inf, math.inf, False)
    assert verdict.outside == -math.inf


def test_outside_covers_the_whole_drive():
    times = np.array([0.0, 1.0, 2.0])
    poses = np.array([(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.0, 0.0, 0.0)])
    assert judge(times, poses, BOX, world(area=(-1, -1, 1, 1))).outside == pytest.approx(0.1)


@pytest.mark.parametrize("seed", range(12))
def test_random_drives_are_judged_as_by_dense_sampling(seed):
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.05, 0.2, 15))
    poses = np.cumsum(random.uniform(-0.2, 0.2, (15, 3)), axis=0)
    bodies = [
        Ellipse(
            tuple(random.uniform(0.05, 0.5, 2)),
            PolylineMotion(
                (0.0, 1.0), tuple(map(tuple, random.uniform(-2, 2, (2, 2)))), (0.3, -0.5)
            ),
            random.uniform(-3, 3),
        )
        for _ in range(2)
    ]
    bodies.append(Wall(*random.uniform(-2, 2, 3), *random.uniform(0.05, 0.5, 2)))
    verdict = judge(times, poses, BOX, world(*bodies))
    dense = np.linspace(times[0], times[-1], 40_001)
    there = np.stack([np.interp(dense, times, poses[:, i]) for i in range(3)], axis=1)
    gaps = [
        ellipse_gap(
            there,
            BOX,
            b.place.at(dense),
            np.tile(b.semi_axes, (len(dense), 1)),
            np.full(len(dense), b.angle),
        )
        for b in bodies[:2]
    ]
    gaps.append(wall_gap(there, BOX, np.tile(astuple(bodies[2]), (len(dense), 1))))
    nearest = np.min(gaps, axis=0)
    assert verdict.gap <= nearest.min() + CONTACT_GAP
    assert verdict.gap >= nearest.min() - 2e-3  # what may lie between two of the dense samples
    if nearest.min() > CONTACT_GAP + 1e-3:
        assert verdict.contact == math.inf
    elif nearest.min() < 0.0:
        touching = dense[np.argmax(nearest <= 0.0)]
        assert verdict.contact <= touching + 1e-9
        assert nearest[dense < verdict.contact - 1e-3].min(initial=1.0) > 0.0


# ---- what is refused ----------------------------------------------------------------------------


def test_route_is_clamped_before_its_start_and_after_its_end():
    route = PolylineMotion((1.0, 2.0), ((0.0, 0.0), (2.0, 0.0)), (0.0, 1.0))
    at = route.at(np.array([0.0, 1.5, 2.0, 4.0]))
    assert at == pytest.approx(np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0)]))
    assert route(1.5) == pytest.approx([1.0, 0.0])
    assert route.speed == 2.0


@pytest.mark.parametrize(
    "make",
    [
        lambda: Box(0.0, 0.5),
        lambda: Ellipse((0.1, -0.1), PolylineMotion.still(0, 0)),
        lambda: Ellipse((0.1, 0.1), PolylineMotion.still(0, 0), math.nan),
        lambda: Wall(0, 0, math.inf, 1, 1),
        lambda: Wall(0, 0, 0, 1, 0),
        lambda: PolylineMotion((), ()),
        lambda: PolylineMotion((0.0, 0.0), ((0, 0), (1, 1))),
        lambda: PolylineMotion((0.0,), ((math.nan, 0),)),
        lambda: World(area=(0, 0, 0, 1)),
        lambda: judge(np.array([0.0]), np.zeros((2, 3)), BOX, World()),
        lambda: judge(np.array([0.0, 0.0]), np.zeros((2, 3)), BOX, World()),
        lambda: judge(np.array([0.0]), np.full((1, 3), math.nan), BOX, World()),
    ],
)
def test_invalid_input_is_refused(make):
    with pytest.raises(InputError):
        make()
