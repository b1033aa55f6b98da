"""Distances of the robot's parts, against a physics engine that reads the URDF."""

import math

import numpy as np
import pytest

from omniman_ros.collision.body_geometry import PLATFORM, BodyGeometry
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.errors import InputError

pytest.importorskip("mujoco", reason="the reference is a physics engine")

from test.collision.reference import BOX, CYLINDER, MESH, EngineBody, Shape, description
from test.outlines import HAND_MADE, outlined

ACCURACY = 1e-6  #: Largest difference from the reference [m]
LOAD = LoadShape(length=0.3, width=0.2, height=0.15, distance=0.04)  #: A load
SOLIDS = UprightObstacles.join(
    [
        UprightObstacles.cylinder(1.0, 0.3, 0.15, (0.0, 1.5)),
        UprightObstacles.cylinder(-0.6, 0.9, 0.3, (0.9, 1.2)),
        UprightObstacles.box((0.9, -0.7, 0.4), 1.2, 0.7, (0.7, 0.74)),
        UprightObstacles.box((-1.2, -0.4, 1.2), 2.0, 0.05, (0.0, 2.0)),
    ]
)  #: A post, a drum that hangs, a table's top and a wall
SOLID_SHAPES = (
    Shape("", CYLINDER, (0.15, 0.75), (1.0, 0.3, 0.75)),
    Shape("", CYLINDER, (0.3, 0.15), (-0.6, 0.9, 1.05)),
    Shape("", BOX, (0.6, 0.35, 0.02), (0.9, -0.7, 0.72), 0.4),
    Shape("", BOX, (1.0, 0.025, 1.0), (-1.2, -0.4, 1.0), 1.2),
)  #: The same for the engine


def platform_shape(parameters):
    """Return the platform's box, up to the mount of the arm, as a shape of the engine."""
    body, top = parameters.robot.body, parameters.mount.z
    size = 0.5 * body.length, 0.5 * body.width, 0.5 * top
    return Shape("base_link", BOX, size, (0.0, 0.0, 0.5 * top))


def prism_shapes(parameters, pieces):
    """Return prisms with convex outlines, up to the mount of the arm, as shapes of the engine."""
    heights = 0.0, parameters.mount.z
    corners = [[(x, y, z) for x, y in piece for z in heights] for piece in pieces]
    return [Shape("base_link", MESH, tuple(each), (0.0, 0.0, 0.0)) for each in corners]


def load_shape(load):
    """Return a load as a shape of the engine."""
    size = 0.5 * load.length, 0.5 * load.width, 0.5 * load.height
    return Shape("wrist_3_link", BOX, size, (0.0, 0.0, load.distance + 0.5 * load.height))


def configurations(count, seed):
    """Return random poses (count, 3) and joint angles (count, 6)."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform((-1.5, -1.5, -math.pi), (1.5, 1.5, math.pi), (count, 3))
    return poses, rng.uniform(-math.pi, math.pi, (count, 6))


def require_equal(found, reference, slack=0.0):
    """Require that distances are those of the reference; both count as zero in an overlap."""
    found, reference = np.maximum(found, 0.0), np.maximum(reference, 0.0)
    assert (found <= reference + ACCURACY).all()
    assert (found >= reference - ACCURACY - slack).all()


@pytest.fixture(scope="module", params=[None, LOAD], ids=["empty", "loaded"])
def load(request):
    """Return a load, or None."""
    return request.param


@pytest.mark.parametrize(
    "count", [60, pytest.param(10_000, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
def test_distances_between_the_robots_own_parts(load, count):
    """Each pair that may collide has the distance that the engine finds in the URDF."""
    parameters = description()
    body = BodyGeometry(parameters, load=load)
    extra = [platform_shape(parameters)] + ([load_shape(load)] if load else [])
    engine = EngineBody(parameters, extra)
    poses, q = configurations(count, seed=2)
    shapes = {name: engine.shapes(name) for name in body.parts if name.endswith(("link", "tia"))}
    shapes |= dict(zip((PLATFORM, "load"), ([number] for number in engine.extra), strict=False))
    if load:  # the last shape of wrist_3 is the load
        shapes["wrist_3_link"] = shapes["wrist_3_link"][:-1]
    reference = np.empty((count, len(body.pairs)))
    for k in range(count):
        engine.place(poses[k], q[k])
        reference[k] = [engine.distance(shapes[a], shapes[b]) for a, b in body.pairs]
    require_equal(body.self_distances(q), reference)


@pytest.mark.parametrize(
    "count", [60, pytest.param(10_000, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
def test_distances_from_solids(load, count):
    """Each part has the distance from each solid that the engine finds."""
    parameters = description()
    body = BodyGeometry(parameters, load=load)
    extra = [*SOLID_SHAPES, platform_shape(parameters)] + ([load_shape(load)] if load else [])
    engine = EngineBody(parameters, extra)
    poses, q = configurations(count, seed=3)
    obstacles, own = engine.extra[: len(SOLIDS)], engine.extra[len(SOLIDS) :]
    shapes = [own[:1], *(engine.shapes(name) for name in body.parts[1:8])]
    if load:
        shapes[-1] = shapes[-1][:-1]
        shapes.append(own[1:])
    reference = np.empty((count, len(shapes), len(SOLIDS)))
    for k in range(count):
        engine.place(poses[k], q[k])
        reference[k] = [[engine.distance(part, [one]) for one in obstacles] for part in shapes]
    found = body.distances(poses, q, SOLIDS)
    require_equal(found[:, :8], reference[:, :8])
    slack = np.maximum(SOLIDS.rounding, 0.0)
    require_equal(found[:, 8:], reference[:, 8:], slack)


@pytest.mark.parametrize(
    "count", [60, pytest.param(10_000, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
@pytest.mark.parametrize("name", HAND_MADE)
def test_distances_of_a_platform_with_an_outline(name, load, count):
    """From solids, links of the arm and a load, those of its pieces that were found by hand."""
    outline, pieces = HAND_MADE[name]
    parameters = outlined(outline)
    body = BodyGeometry(parameters, load=load)
    prisms = prism_shapes(parameters, pieces)
    extra = [*SOLID_SHAPES, *prisms] + ([load_shape(load)] if load else [])
    engine = EngineBody(parameters, extra)
    poses, q = configurations(count, seed=6)
    obstacles = engine.extra[: len(SOLIDS)]
    platform = engine.extra[len(SOLIDS) : len(SOLIDS) + len(prisms)]
    shapes = {n: engine.shapes(n) for n in body.parts if n.endswith("link")}
    if load:
        shapes |= {"load": engine.extra[-1:], "wrist_3_link": shapes["wrist_3_link"][:-1]}
    pairs = [k for k, pair in enumerate(body.pairs) if PLATFORM in pair]
    others = [body.pairs[k][1] for k in pairs]
    to_obstacles, to_parts = np.empty((count, len(SOLIDS))), np.empty((count, len(others)))
    for k in range(count):
        engine.place(poses[k], q[k])
        to_obstacles[k] = [engine.distance(platform, [one]) for one in obstacles]
        to_parts[k] = [engine.distance(platform, shapes[other]) for other in others]
    assert (to_obstacles <= 0.0).any() and (to_parts <= 0.0).any(), "some touch"
    require_equal(body.distances(poses, q, SOLIDS)[:, 0], to_obstacles)
    require_equal(body.self_distances(q)[:, pairs], to_parts)


def test_a_post_between_the_forks_is_clear_of_them():
    """What stands in the recess of an outline is outside; what lies within it is touched."""
    parameters = outlined(HAND_MADE["forks"][0])
    body = BodyGeometry(parameters)
    for x, gap in ((0.4, 0.1), (0.02, 0.0), (-0.3, 0.0)):
        post = UprightObstacles.cylinder(x, 0.0, 0.02, (0.0, 1.0))
        found = body.distances(np.zeros(3), np.zeros(6), post)[0, 0]
        assert found == pytest.approx(gap and 0.14 * math.cos(math.atan(0.1)) - 0.02, abs=1e-9)


def test_a_lower_bound_is_enough_beyond_the_reach():
    """Distances up to the reach are exact; the others are above it, and not too large."""
    body = BodyGeometry(description(), ToolShape(length=0.2), LOAD)
    poses, q = configurations(200, seed=4)
    for exact, bound in (
        (body.self_distances(q), body.self_distances(q, 0.1)),
        (body.distances(poses, q, SOLIDS), body.distances(poses, q, SOLIDS, 0.1)),
    ):
        assert np.allclose(exact[exact <= 0.1], bound[exact <= 0.1], rtol=0.0, atol=1e-7)
        assert (bound[exact > 0.1] > 0.1 - 1e-7).all()
        assert (bound <= exact + 1e-7).all()


def test_overlap_is_negative_to_the_depth_of_a_radius():
    """A post in the forearm counts with its depth, and a post in its axis with the radius."""
    body = BodyGeometry(description())
    q, still = np.array([0.0, -0.5 * math.pi, 0.0, 0.0, 0.0, 0.0]), np.zeros(3)  # straight up
    part = body.parts.index("forearm_link")
    away, heights = np.array((-1.0, -1.0)), (1.15, 1.2)

    def distance(offset):
        """Return the distance from a post, moved from afar towards the forearm."""
        x, y = np.array((0.2, 0.0)) - away + offset * away / math.sqrt(2.0)
        post = UprightObstacles.cylinder(x, y, 0.05, heights)
        return body.distances(still, q, post)[part, 0]

    free, touching = 0.0, 1.4
    while touching - free > 1e-9:
        middle = 0.5 * (free + touching)
        free, touching = (middle, touching) if distance(middle) > 0.0 else (free, middle)
    assert -0.02 <= distance(touching + 0.02) < -0.012
    through = UprightObstacles.box((0.2, 0.0, 0.0), 2.0, 2.0, (0.0, 3.0))
    assert body.distances(still, q, through)[part, 0] == pytest.approx(-0.045, abs=1e-9)


def test_the_start_posture_sticks_out_of_the_platform():
    """The arm's default start posture is wider than the platform, above its deck."""
    parameters = description()
    body = BodyGeometry(parameters)
    q = np.array((-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031))
    assert body.self_distances(q).min() > 0.01
    wall = UprightObstacles.box((0.0, 0.55, 0.0), 4.0, 0.1, (0.0, 2.0))
    distances = body.distances(np.zeros(3), q, wall)[:, 0]
    assert distances[0] == pytest.approx(0.5 - 0.5 * parameters.robot.body.width)
    assert distances.min() < 0.0


def test_pairs_that_are_left_out_hardly_depend_on_the_joints():
    """No pair of the body collides at every angle of the joints, nor at none of them."""
    body = BodyGeometry(description(), ToolShape(length=0.15))
    _, q = configurations(4000, seed=5)
    touching = (body.self_distances(q) <= 0.0).mean(axis=0)
    assert ((touching > 0.0) & (touching < 0.9)).all()


def test_a_robot_without_an_arm_is_its_platform():
    """A platform has one part, no pair, and distances from what stands."""
    body = BodyGeometry(description("ig42"))
    assert body.parts == (PLATFORM,)
    assert body.self_distances(np.zeros((5, 6))).shape == (5, 0)
    assert body.distances(np.zeros((5, 3)), np.zeros((5, 6)), SOLIDS).shape == (5, 1, len(SOLIDS))


def test_no_solids_give_no_distances():
    """Where nothing stands there is nothing to be near."""
    body = BodyGeometry(description(), load=LOAD)
    found = body.distances(np.zeros((2, 3)), np.zeros((2, 6)), UprightObstacles.join([]))
    assert found.shape == (2, len(body.parts), 0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(bad):
    """An unknown pose or angle is an error, not a large distance."""
    body = BodyGeometry(description())
    q, poses = np.zeros((2, 6)), np.zeros((2, 3))
    q[1, 2] = bad
    with pytest.raises(InputError, match="joint angles"):
        body.self_distances(q)
    with pytest.raises(InputError, match="joint angles"):
        body.distances(poses, q, SOLIDS)
    poses[0, 0] = bad
    with pytest.raises(InputError, match="poses"):
        body.distances(poses, np.zeros((2, 6)), SOLIDS)
