"""Motions that bring the robot against itself, against a dense look at all of their distances."""

import math

import numpy as np
import pytest

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.self_collision import SelfCollisionCheck, SelfCollisionOptions
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.robots import robot_parameters

#: Joint angles at which the arm points up [rad]
UPRIGHT = np.array([0.0, -0.5 * math.pi, 0.0, -0.5 * math.pi, 0.0, 0.0])
#: Joint angles at which the forearm lies along the upper arm [rad]
FOLDED = np.array([0.0, -0.5 * math.pi, 2.9, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def body():
    """Return the shapes of the robot with a tool and a load."""
    description = build(DescriptionParameters, robot_parameters("omniman"))
    load = LoadShape(length=0.2, width=0.15, height=0.1, distance=0.15)
    return BodyGeometry(description, ToolShape(length=0.15), load)


def check(body, **options):
    """Return a check with the default options, but for some."""
    return SelfCollisionCheck(body, SelfCollisionOptions(**options))


def motion(*points, duration=2.0):
    """Return a motion through joint angles that stops at each of them."""
    times = np.linspace(0.0, duration, len(points))
    still = np.zeros((len(points), 6))
    return TimedCurve(times, np.array(points), still, still)


def random_motion(rng):
    """Return a motion through three random sets of joint angles, fast in the second one."""
    points = rng.uniform(-1.5, 1.5, (3, 6)) + UPRIGHT
    speeds, still = np.zeros((3, 6)), np.zeros((3, 6))
    speeds[1] = rng.uniform(-1.0, 1.0, 6)
    return TimedCurve(np.array([0.0, 2.0, 4.0]), points, speeds, still)


def dense_distances(body, curve):
    """Return the distances of all pairs at 500 times."""
    times = np.linspace(0.0, curve.duration, 500)
    return body.self_distances(curve.sample(times)[0])


@pytest.mark.parametrize(
    "count", [25, pytest.param(10_000, marks=pytest.mark.exhaustive)], ids=["few", "many"]
)
def test_no_colliding_motion_passes_and_no_clear_one_is_refused(body, count):
    """What passes keeps clear everywhere; what is refused comes within the margin somewhere."""
    rng, tested = np.random.default_rng(8), check(body)
    passed = 0
    for _ in range(count):
        curve = random_motion(rng)
        least = dense_distances(body, curve)
        allowed = np.minimum(tested.options.margin, least[0] - 0.001)
        approach = tested.first_approach(curve)
        if approach is None:
            passed += 1
            assert (least > np.minimum(0.0, allowed)).all()
        else:
            pair = body.pairs.index(approach.parts)
            assert least[:, pair].min() < allowed[pair] + 2e-3
    assert 0.05 * count < passed < 0.95 * count


def test_the_message_names_parts_time_and_depth(body):
    """A forearm that is folded onto the upper arm is refused before it moves."""
    with pytest.raises(InputError, match="with itself") as refused:
        check(body).require_clear(motion(UPRIGHT, FOLDED))
    approach = check(body).first_approach(motion(UPRIGHT, FOLDED))
    assert str(approach) in str(refused.value)
    assert 0.5 < approach.time < 2.0
    assert approach.distance <= 0.0
    assert all(part in str(approach) for part in approach.parts)


def test_a_touch_between_two_points_is_found(body):
    """A motion whose ends are clear, and which passes through the robot fast, is refused."""
    a, b = UPRIGHT.copy(), UPRIGHT.copy()
    a[1], b[1] = -0.5 * math.pi + 1.2, -0.5 * math.pi + 1.2
    a[0], b[0] = 0.0, 0.5
    a[2] = b[2] = 1.1
    down = a.copy()
    down[1] += 1.0
    assert check(body).first_approach(motion(a, a + 1e-6)) is None
    curve = motion(a, down, b, duration=0.2)
    assert dense_distances(body, curve).min() < 0.0
    assert check(body).first_approach(curve) is not None


def test_an_arm_within_the_margin_may_leave_but_not_come_nearer(body):
    """A start that is too near does not trap the arm, nor does it allow anything."""
    curve = motion(UPRIGHT, FOLDED)
    times = np.linspace(0.0, 2.0, 4000)
    q = curve.sample(times)[0]
    least = body.self_distances(q).min(axis=1)
    near = q[int((least < 0.004).argmax())]
    assert check(body).first_approach(motion(near, UPRIGHT)) is None
    deeper = near + 0.02 * (FOLDED - UPRIGHT)
    assert check(body).first_approach(motion(near, deeper)) is not None


def test_the_check_can_be_switched_off(body):
    """With `check` off, every motion passes."""
    check(body, check=False).require_clear(motion(UPRIGHT, FOLDED))


def test_a_larger_margin_refuses_more(body):
    """What passes with a margin may not pass with a larger one, and never the other way."""
    rng = np.random.default_rng(9)
    small, large = check(body, margin=0.005), check(body, margin=0.08)
    refused = [
        (small.first_approach(curve) is not None, large.first_approach(curve) is not None)
        for curve in (random_motion(rng) for _ in range(25))
    ]
    assert all(b or not a for a, b in refused)
    assert any(b and not a for a, b in refused)


def test_the_heading_and_place_of_the_platform_do_not_matter(body):
    """The last six of nine axes are the arm's."""
    arm = motion(UPRIGHT, FOLDED)
    axes = np.hstack([[[1.0, 2.0, 3.0], [4.0, -2.0, 1.0]], arm.positions])
    still = np.zeros((2, 9))
    both = TimedCurve(arm.times, axes, still, still)
    assert check(body).first_approach(both) == check(body).first_approach(arm)
