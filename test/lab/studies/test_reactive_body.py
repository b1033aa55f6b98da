import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.lab.studies.avoidance_scenes import START, SceneGenerator
from omniman_ros.lab.studies.reactive_body import ReactiveBody
from omniman_ros.planning.whole_body.controller import PERIOD
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.simulation.world.distances import ConfigurationDistances

LIMIT = 30.0  #: [s]
DIRECTION = np.array([0.6, 0.8, 0.0])


@pytest.fixture(scope="module")
def generator():
    return SceneGenerator("omniman")


def straight(generator):
    """Return poses (4, 4, 4) of a tool that moves by 1 m."""
    poses = np.repeat(generator.model.forward(START)[None], 4, axis=0)
    poses[:, :3, 3] += np.outer(np.linspace(0.25, 1.0, 4), DIRECTION)
    return poses


def drive(body, around):
    """Return times (k,), axes (k, 9) and rates (k, 9) of a body whose rates are executed."""
    axes, rates = [START], [np.zeros(9)]
    while not body.is_completed and len(axes) < LIMIT / PERIOD:
        now = PERIOD * (len(axes) - 1)
        rates.append(body.cycle(axes[-1], now, around(now)))
        axes.append(axes[-1] + PERIOD * rates[-1])
    return PERIOD * np.arange(len(axes)), np.array(axes), np.array(rates)


def things_of(scene, now):
    """Return what is in a scene at a time, whose obstacles either all stand or all walk."""
    centres = zip(scene.places_at(now).tolist(), scene.things, strict=True)
    there = UprightObstacles.join(
        [UprightObstacles.cylinder(*xy, each.semi_axes[0], each.heights) for xy, each in centres]
    )
    if not scene.velocities.any():
        return ObstacleSnapshot(now, there)
    growth = np.full(len(scene.things), 0.05)
    return ObstacleSnapshot(now, moving=MovingObstacles(there, scene.velocities.T), growth=growth)


def assert_limits_are_kept(limits, axes, rates):
    assert (np.abs(rates) <= limits.velocity + 1e-4).all()
    assert (np.hypot(*rates[:, :2].T) <= limits.velocity[0] + 1e-4).all()
    changes = np.abs(np.diff(rates, axis=0)) / PERIOD
    assert (changes <= limits.acceleration + 1e-3).all()
    assert (np.hypot(*changes[:, :2].T) <= limits.acceleration[0] + 1e-3).all()
    c, s = np.cos(axes[:-1, 2]), np.sin(axes[:-1, 2])
    x, y, w = rates[1:, :3].T
    wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ limits.wheels.T
    assert np.abs(wheels).max() <= limits.wheel_speed + 1e-3
    assert ((axes >= limits.lower) & (axes <= limits.upper)).all()


def test_alone_the_tool_completes_a_straight_and_rests_at_its_end(generator):
    poses = straight(generator)
    body = ReactiveBody(generator.setup, poses, START)
    _, axes, rates = drive(body, lambda now: ObstacleSnapshot(now))
    assert body.is_completed and body.braked == 0
    tool, first = generator.model.forward(axes), generator.model.forward(START)
    way = tool[:, :3, 3] - first[:3, 3]
    along = way @ DIRECTION
    assert np.linalg.norm(way - np.outer(along, DIRECTION), axis=1).max() < 0.001
    assert along[-1] == pytest.approx(1.0, abs=0.001)
    assert np.abs(tool[:, :3, :3] - first[:3, :3]).max() < 0.005
    speeds = np.linalg.norm(np.diff(tool[:, :3, 3], axis=0), axis=1) / PERIOD
    assert speeds.max() < 1.05 * generator.setup.path.linear_velocity
    assert_limits_are_kept(generator.setup.limits, axes, rates)


@pytest.mark.parametrize("kind", ["posts", "persons"])
def test_what_is_in_the_way_of_the_fixed_posture_is_not_touched(generator, kind):
    scene = generator.scene(kind, 0)
    assert scene is not None
    body = ReactiveBody(generator.setup, scene.poses, START)
    times, axes, rates = drive(body, lambda now: things_of(scene, now))
    assert body.is_completed
    judge = ConfigurationDistances(generator.setup.description, scene.things)
    for q, now in zip(axes, times.tolist(), strict=True):
        judge.place(q[:3], q[3:], scene.places_at(now))
        assert judge.distances(1.0).min() > 0.05
    assert_limits_are_kept(generator.setup.limits, axes, rates)
    off = body.model.forward(axes[-1])[:3, 3] - scene.poses[-1, :3, 3]
    assert np.linalg.norm(off) < 0.005


def test_the_robot_brakes_where_two_walkers_leave_no_solution(generator):
    body = ReactiveBody(generator.setup, straight(generator), START)
    axes, rates = START, np.zeros(9)
    for k in range(20):
        rates = body.cycle(axes, PERIOD * k, ObstacleSnapshot(PERIOD * k))
        axes = axes + PERIOD * rates
    assert body.braked == 0
    walkers = [UprightObstacles.cylinder(0.0, y, 0.25, (0.0, 1.8)) for y in (-1.2, 1.2)]
    coming = MovingObstacles(UprightObstacles.join(walkers), np.array([[0.0, 0.0], [1.0, -1.0]]))
    around = ObstacleSnapshot(1.0, moving=coming, growth=np.zeros(2))
    braking = body.cycle(axes, 1.0, around)
    assert body.braked == 1
    assert (np.abs(braking) <= np.abs(rates)).all() and (braking * rates >= 0.0).all()
    assert np.hypot(*braking[:2]) < np.hypot(*rates[:2])
