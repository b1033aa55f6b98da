import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import MAX_POINTS, Preview


def polynomials(degree, seed):
    """Evaluate three random polynomials of a degree and their derivatives at times."""
    rng = np.random.default_rng(seed)
    functions = [np.polynomial.Polynomial(rng.uniform(-1, 1, degree + 1)) for _ in range(2)]
    functions.append(np.polynomial.Polynomial(rng.uniform(-0.05, 0.05, degree + 1)))
    return [
        lambda t, d=d: np.stack([f.deriv(d)(np.asarray(t)) for f in functions], axis=-1)
        for d in range(3)
    ]


TIMES = np.array([10.0, 10.3, 10.35, 11.2, 12.0])
INNER = np.linspace(10.0, 11.999, 97)


def preview(degree, with_acceleration, seed=1):
    pose, velocity, acceleration = polynomials(degree, seed)
    s = TIMES - 10
    return Preview(TIMES, pose(s), velocity(s), acceleration(s) if with_acceleration else None), (
        pose,
        velocity,
        acceleration,
    )


@pytest.mark.parametrize(("degree", "with_acceleration"), [(3, False), (5, True), (3, True)])
@pytest.mark.parametrize("seed", range(5))
def test_interpolation_reproduces_polynomials_of_its_degree(degree, with_acceleration, seed):
    made, (pose, velocity, acceleration) = preview(degree, with_acceleration, seed)
    for t in INNER:
        setpoint = made.sample(t)
        np.testing.assert_allclose(setpoint.pose, pose(t - 10), atol=1e-9)
        np.testing.assert_allclose(setpoint.velocity, velocity(t - 10), atol=1e-7)
        np.testing.assert_allclose(setpoint.acceleration, acceleration(t - 10), atol=1e-5)


@pytest.mark.parametrize("with_acceleration", [True, False])
def test_velocity_and_acceleration_are_the_derivatives_of_the_pose(with_acceleration):
    made, _ = preview(6, with_acceleration)  # of a degree higher than the interpolation reproduces
    h = 1e-5
    for t in (10.11, 10.33, 10.8, 11.5, 11.9):
        before, now, after = (made.sample(t + k * h) for k in (-1, 0, 1))
        np.testing.assert_allclose(
            (after.pose - before.pose) / (2 * h), now.velocity, rtol=1e-5, atol=1e-6
        )
        np.testing.assert_allclose(
            (after.velocity - before.velocity) / (2 * h), now.acceleration, rtol=1e-5, atol=1e-5
        )
        assert now.pose.shape == now.velocity.shape == now.acceleration.shape == (3,)


@pytest.mark.parametrize("with_acceleration", [True, False])
def test_preview_passes_through_its_points_continuously(with_acceleration):
    made, (pose, velocity, _) = preview(6, with_acceleration)
    for t in TIMES[1:-1]:
        for at in (t - 1e-9, t, t + 1e-9):
            np.testing.assert_allclose(made.sample(at).pose, pose(t - 10), atol=1e-6)
            np.testing.assert_allclose(made.sample(at).velocity, velocity(t - 10), atol=1e-5)


def test_order_of_the_query_times_does_not_matter():
    made, _ = preview(5, True)
    ahead = [made.sample(t).pose for t in INNER]
    order = np.random.default_rng(3).permutation(len(INNER))
    for i in order:
        np.testing.assert_array_equal(made.sample(INNER[i]).pose, ahead[i])


def test_preview_rests_at_its_ends_before_and_after():
    made, (pose, _, _) = preview(5, True)
    for t, s in ((9.0, 0.0), (9.999, 0.0), (12.0, 2.0), (50.0, 2.0)):
        setpoint = made.sample(t)
        np.testing.assert_allclose(setpoint.pose, pose(s))
        assert not setpoint.velocity.any()
        assert not setpoint.acceleration.any()
    assert (made.start, made.end) == (10.0, 12.0)


def test_preview_that_starts_now_moves_now():
    # With one shared simulated clock, each new preview starts exactly at the tick.
    made, (pose, velocity, _) = preview(5, True)
    np.testing.assert_allclose(made.sample(10.0).pose, pose(0.0))
    np.testing.assert_allclose(made.sample(10.0).velocity, velocity(0.0))


def test_single_point_is_a_preview_at_rest():
    made = Preview(np.array([3.0]), np.array([[1.0, 2, 3]]), np.zeros((1, 3)))
    for t in (0.0, 3.0, 9.0):
        np.testing.assert_array_equal(made.sample(t).pose, [1, 2, 3])
        assert not made.sample(t).velocity.any()
    assert made.end_speed == 0.0


def test_end_speed_is_zero_only_for_a_preview_that_ends_at_rest():
    velocities = np.array([[0.0, 0, 0], [0.1, -0.4, 0.2]])
    made = Preview(np.array([0.0, 1.0]), np.zeros((2, 3)), velocities)
    assert made.end_speed == 0.4
    velocities[1] = [0.0, -5.2e-5, 1e-4]  # round-off of a planner
    assert Preview(np.array([0.0, 1.0]), np.zeros((2, 3)), velocities).end_speed == 0.0


def test_points_that_repeat_each_other_but_for_round_off_are_one():
    poses = np.array([[0.0, 0, 3.1], [0.0, 0, 3.1], [1.0, 0, -3.1], [1.0, 0, -3.1 - 1e-7]])
    made = Preview(np.array([0.0, 0.0, 1.0, 1.0]), poses, np.zeros((4, 3)))
    assert made.sample(0.5).velocity == pytest.approx([1.5, 0.0, 1.5 * (math.tau - 6.2)], abs=1e-6)


@pytest.mark.parametrize("turns", [1, -1])
def test_headings_are_continuous_across_half_a_turn(turns):
    headings = turns * np.array([3.0, 3.1, 3.2, 3.3])
    wrapped = np.arctan2(np.sin(headings), np.cos(headings))
    assert abs(np.diff(wrapped)).max() > 6
    poses = np.column_stack([np.zeros((4, 2)), wrapped])
    velocities = np.tile([0, 0, turns * 0.1], (4, 1))
    made = Preview(np.arange(4.0), poses, velocities)
    for t in np.linspace(0.01, 2.99, 50):
        assert made.sample(t).pose[2] == pytest.approx(turns * (3.0 + 0.1 * t))
        assert made.sample(t).velocity[2] == pytest.approx(turns * 0.1)
    np.testing.assert_array_equal(poses[:, 2], wrapped)  # the caller's array is not modified


def test_large_times_keep_the_accuracy():
    pose, velocity, acceleration = polynomials(5, 1)
    s, start = np.array([0.0, 0.5, 1.0]), 4e6  # 46 days of uptime
    made = Preview(start + s, pose(s), velocity(s), acceleration(s))
    for t in (0.1, 0.7):
        np.testing.assert_allclose(made.sample(start + t).pose, pose(t), atol=1e-8)


GOOD = {"times": np.arange(2.0), "poses": np.zeros((2, 3)), "velocities": np.zeros((2, 3))}
BAD = np.array([[0, 0, 0], [0, math.nan, 0]])
BAD_SIZE = np.array([[0, 0, 0], [0, 1e300, 0]])


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"times": np.zeros(0)}, "got 0"),
        ({"times": np.arange(MAX_POINTS + 1.0)}, "got 5001"),
        ({"poses": np.zeros((3, 3))}, r"poses have shape \(3, 3\), expected \(2, 3\)"),
        ({"velocities": np.zeros((2, 2))}, "velocities have shape"),
        ({"accelerations": np.zeros((1, 3))}, "accelerations have shape"),
        ({"times": np.array([0, math.inf])}, "not finite"),
        ({"times": np.array([math.nan, 1])}, "not finite"),
        ({"poses": BAD}, "not finite"),
        ({"velocities": BAD}, "not finite"),
        ({"accelerations": BAD}, "not finite"),
        ({"poses": BAD_SIZE}, "beyond"),
        ({"velocities": BAD_SIZE}, "beyond"),
        ({"accelerations": BAD_SIZE}, "beyond"),
        ({"times": np.array([1.0, 1.0]), "poses": np.eye(3)[:2]}, "do not increase"),
        ({"times": np.array([1.0, 0.5])}, "do not increase"),
    ],
)
def test_invalid_input_is_rejected(changes, why):
    with pytest.raises(InputError, match=why):
        Preview(**{**GOOD, **changes})
