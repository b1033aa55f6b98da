"""Bounds of the robot from above, against a physics engine that reads the URDF."""

import math

import numpy as np
import pytest

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.footprint import Footprint, Limbs
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.planning.obstacles.separation import box_gap, outside_by

pytest.importorskip("mujoco", reason="the reference is a physics engine")

from test.collision.reference import CYLINDER, EngineBody, Shape, description
from test.collision.test_body_geometry import load_shape, platform_shape
from test.outlines import FORKS, outlined

LOAD = LoadShape(length=0.3, width=0.2, height=0.15, distance=0.04)
MARGIN = 0.05
REST = np.array([0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0])


@pytest.fixture(scope="module")
def loaded():
    return BodyOutline(description(), load=LOAD)


def planar_gap(footprint, pose, x, y, radius, low, high):
    """Return the bound of the distance from a cylinder between two heights."""
    boxes, index = footprint.against(np.array([low]), np.array([high]))
    if not len(index):
        return math.inf
    centers = np.tile([x, y], (1, len(index), 1))
    axes = np.full((1, len(index), 2), radius)
    return box_gap(pose[None], boxes, centers, axes, np.zeros(len(index))).min()


@pytest.mark.parametrize(
    "count", [150, pytest.param(5000, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
def test_the_bound_is_never_above_the_distance_that_the_engine_finds(loaded, count):
    """An obstacle farther than the vertical margin from all parts may be left out."""
    parameters, rng = description(), np.random.default_rng(4)
    obstacles = []
    for _ in range(12):
        low = rng.uniform(0.0, 1.6)
        obstacles.append((0.0, 0.0, rng.uniform(0.03, 0.4), low, low + rng.uniform(0.02, 1.0)))
    shapes = [
        Shape("", CYLINDER, (r, 0.5 * (b - a)), (x, y, 0.5 * (a + b)))
        for x, y, r, a, b in obstacles
    ]
    engine = EngineBody(parameters, [*shapes, platform_shape(parameters), load_shape(LOAD)])
    obstacle = engine.extra[: len(obstacles)]
    parts = [number for number in range(engine.model.ngeom) if number not in obstacle]
    own = [n for n in parts if engine.model.geom_bodyid[n] not in wheel_bodies(engine)]
    touched = 0
    for _ in range(count):
        pose = rng.uniform((-0.9, -0.9, -math.pi), (0.9, 0.9, math.pi))
        q = rng.uniform(-math.pi, math.pi, 6)
        engine.place(pose, q)
        footprint = loaded.footprint(q[None], MARGIN)
        number = rng.integers(len(obstacles))
        distance = engine.distance(own, [obstacle[number]])
        bound = planar_gap(footprint, pose, *obstacles[number])
        assert min(bound, MARGIN) <= distance + 1e-6
        touched += distance <= 0.0
    assert 0.1 * count < touched < 0.9 * count, "the cases show both"


def wheel_bodies(engine):
    """Return the numbers of the bodies of wheels, which are below the platform's box."""
    model = engine.model
    return {k for k in range(model.nbody) if "wheel" in model.body(k).name}


def test_the_bounds_of_an_arm_ahead_of_the_platform(loaded):
    whole = loaded.footprint(REST[None], MARGIN).whole
    assert len(whole.yaw) == 3
    ahead, left, behind, right = whole.support(0.5 * math.pi * np.arange(4))
    assert 0.7 < ahead < 0.85
    np.testing.assert_allclose([left, behind, right], [0.35, 0.5, 0.35])


def test_a_raised_arm_leaves_only_the_platform_at_its_heights(loaded):
    footprint = loaded.footprint(REST[None], MARGIN)
    top = description().mount.z
    low, index = footprint.against(np.array([0.0]), np.array([top - 0.01]))
    np.testing.assert_array_equal(index, [0, 0][: len(index)])
    np.testing.assert_allclose(low.half[0], [0.5, 0.35])
    over, index = footprint.against(np.array([3.0]), np.array([3.2]))
    assert not len(index) and not len(over.yaw)
    _, index = footprint.against(np.array([3.0, 0.0, -math.inf]), np.array([3.2, 0.3, math.inf]))
    assert set(index.tolist()) == {1, 2}


def test_a_platform_without_an_arm_is_one_rectangle_up_to_its_deck():
    body = BodyOutline(description("ig42"), ToolShape(length=0.3), LOAD)
    footprint = body.footprint(np.zeros((0, 6)), MARGIN)
    assert footprint.is_symmetric and not body.has_arm
    box, index = footprint.against(np.array([0.0, 1.0, -math.inf]), np.array([0.1, 1.5, math.inf]))
    assert box.is_single
    np.testing.assert_array_equal(index, [0, 2])
    np.testing.assert_allclose(box.half, [0.4, 0.25])


def test_a_motion_of_the_arm_is_bounded_between_its_postures(loaded):
    rng = np.random.default_rng(5)
    for _ in range(20):
        first = rng.uniform(-2.0, 2.0, 6)
        last = first + rng.uniform(-0.6, 0.6, 6)
        swept = loaded.footprint(np.stack([first, last]), 0.0).whole
        directions = np.linspace(-math.pi, math.pi, 60)
        reach = swept.support(directions)
        for fraction in rng.uniform(0.0, 1.0, 4):
            between = outline(loaded, first + fraction * (last - first), directions)
            assert (between <= reach + 1e-9).all()


def outline(body, q, directions):
    """Return the extents of the arm itself, by its capsules and the load's corners."""
    limbs = body._limbs(np.atleast_2d(q))
    ends = np.concatenate([limbs.start[:2], limbs.end[:2]], axis=1)
    radius = np.concatenate([limbs.radius, limbs.radius])
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1) @ ends
    return (along + radius).max(axis=1)


def test_a_dense_preview_is_bounded_by_few_postures(loaded):
    time = np.linspace(0.0, 0.4, 51)[:, None]
    turns = np.array([1.0, -0.6, 0.8, 0.3, -0.5, 2.0])
    configurations = REST + 0.6 * turns * time + 0.02 * np.sin(9.0 * time) * turns[::-1]
    limbs = loaded._limbs(configurations)
    assert len(limbs.radius) < 0.6 * 51 * len(loaded._limbs(REST[None]).radius)
    directions = np.linspace(-math.pi, math.pi, 60)
    reach = outline(loaded, configurations, directions)
    for q in configurations:
        assert (outline(loaded, q, directions) <= reach + 1e-9).all()


@pytest.mark.parametrize(
    ("configurations", "why"),
    [
        (np.zeros(6), "shape"),
        (np.zeros((0, 6)), "shape"),
        (np.full((1, 6), math.nan), "finite"),
    ],
)
def test_postures_that_cannot_be_used_are_refused(loaded, configurations, why):
    with pytest.raises(InputError, match=why):
        loaded.footprint(configurations, MARGIN)


def test_a_rectangle_beside_base_link_is_where_its_corners_are():
    box = Rectangles(np.array([0.6, -0.2]), np.array(0.7), np.array([0.3, 0.1]))
    pose = np.array([[1.0, 2.0, -2.2]])
    c, s = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    corners = pose[0, :2] + box.corners @ np.array([[c, s], [-s, c]])
    for x, y in corners:  # a tiny disc upon a corner touches, and one 10 cm outwards is 10 cm off
        assert abs(disc_gap(pose, box, x, y)) < 2e-3
    middle = box.poses(pose)[0]
    np.testing.assert_allclose(middle[:2], corners.mean(axis=0))
    for x, y in corners:
        out = np.array([x, y]) - middle[:2]
        x, y = np.array([x, y]) + 0.1 * out / np.hypot(*out)
        assert disc_gap(pose, box, x, y) == pytest.approx(0.1, abs=2e-3)
    outside = outside_by(pose, box, (-9.0, -9.0, float(corners[:, 0].max()), 9.0))
    assert outside[0] == pytest.approx(0.0, abs=1e-12)


def disc_gap(pose, box, x, y, radius=1e-3):
    center = np.array([[[x, y]]])
    return box_gap(pose, box, center, np.full((1, 1, 2), radius), np.zeros(1)).item()


def test_two_rectangles_bound_as_much_as_each_alone():
    rng = np.random.default_rng(6)
    both = Rectangles(
        rng.uniform(-1, 1, (2, 2)), rng.uniform(-3, 3, 2), rng.uniform(0.05, 0.5, (2, 2))
    )
    poses = rng.uniform(-2, 2, (50, 3))
    room = (-3.0, -3.0, 3.0, 3.0)
    each = [outside_by(poses, box, room) for box in both.each()]
    np.testing.assert_allclose(outside_by(poses, both, room), np.max(each, axis=0))
    assert both.select(np.array([False, True])).half.shape == (1, 2)
    single = Footprint(Rectangles.centred(np.array([0.4, 0.3]))).whole
    assert single.select(np.array([True, False])) is single


def test_the_points_of_a_capsule_between_two_heights_are_in_its_rectangle():
    rng = np.random.default_rng(7)
    for _ in range(60):
        ends = rng.uniform((-1.0, -1.0, 0.6), (1.0, 1.0, 1.4), (2, 3))
        if rng.random() < 0.2:
            ends[1, 2] = ends[0, 2]
        radius = rng.uniform(0.02, 0.15)
        limbs = Limbs(ends[:1].T, ends[1:].T, np.array([radius]), np.zeros(1, dtype=int))
        footprint = Footprint(Rectangles.centred(np.array([0.4, 0.3])), (0.0, 0.3), limbs)
        low = rng.uniform(0.45, 1.5)
        high = low + rng.uniform(0.01, 0.3)
        boxes, _ = footprint.against(np.array([low]), np.array([high]))
        normal = rng.normal(size=(2000, 3))
        normal *= radius / np.linalg.norm(normal, axis=1)[:, None]
        points = ends[0] + rng.uniform(0, 1, (2000, 1)) * (ends[1] - ends[0]) + normal
        points = points[(points[:, 2] >= low) & (points[:, 2] <= high)]
        if not len(points):
            continue
        (box,) = boxes.each()
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        own = (points[:, :2] - box.centre) @ np.array([[c, -s], [s, c]])
        assert (np.abs(own) <= box.half + 1e-9).all()


def test_an_outline_is_covered_by_rectangles_beside_those_of_the_arm():
    """A post between the forks is apart from the footprint; one within the outline is not."""
    body = BodyOutline(outlined(FORKS))
    raised = np.array([0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0])
    footprint = body.footprint(raised[None], MARGIN)
    still = np.zeros(3)
    assert planar_gap(footprint, still, 0.4, 0.0, 0.03, 0.0, 0.3) > 0.05
    assert planar_gap(footprint, still, 0.4, 0.3, 0.03, 0.0, 0.3) < 0.0
    assert planar_gap(footprint, still, -0.3, 0.0, 0.03, 0.0, 0.3) < 0.0
    assert not footprint.is_symmetric


def test_a_platform_with_an_outline_and_no_arm_is_its_rectangles():
    outline = [(x * 0.8, y * 0.7) for x, y in FORKS]
    footprint = BodyOutline(outlined(outline, "ig42")).footprint(np.zeros((0, 6)), MARGIN)
    low, index = footprint.against(np.array([0.0, 3.0]), np.array([0.1, 3.2]))
    assert len(low.yaw) > 1 and set(index.tolist()) == {0}


def test_parts_of_the_arm_above_one_rectangle_of_the_platform_are_within_it():
    boxes = Rectangles(
        np.array([(0.3, 0.0), (-0.3, 0.0)]), np.zeros(2), np.array([(0.2, 0.3), (0.2, 0.3)])
    )
    inside = np.array([(0.2, 0.1), (0.4, -0.1)])
    np.testing.assert_array_equal(boxes.contain(inside, 0.0), [True, False])
    np.testing.assert_array_equal(boxes.contain(np.vstack([inside, -inside]), 0.0), [False] * 2)
