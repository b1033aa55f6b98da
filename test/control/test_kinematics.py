import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.kinematics import (
    MIN_REMAINING_FRACTION,
    PlatformKinematics,
    wheel_row,
)
from omniman_ros.core.errors import GeometryError
from omniman_ros.core.platform import Wheels
from test.robots import ALL, kinematics, random_wheels, robot

COUNTS = range(3, 9)
SEEDS = range(6)


def polar_row(length, alpha, delta, gamma, radius):
    """Return the row of CCTA 2017 (8) as printed, with the wheel's position in polar form."""
    return np.array(
        [
            math.cos(delta + gamma),
            math.sin(delta + gamma),
            length * math.sin(delta + gamma - alpha),
        ]
    ) / (radius * math.cos(gamma))


def platform(n, seed):
    wheels = random_wheels(np.random.default_rng([n, seed]), n)
    return wheels, PlatformKinematics(wheels)


def symmetric(a, b, radius):
    """Return the paper's Fig. 4 platform: front right, front left, rear left, rear right."""
    quarter = math.pi / 4
    wheels = Wheels(
        names=("1", "2", "3", "4"),
        x=(b, b, -b, -b),
        y=(-a, a, a, -a),
        heading=(0.0,) * 4,
        roller_angle=(quarter, -quarter, quarter, -quarter),
        radius=(radius,) * 4,
        inertia=(0.1,) * 4,
    )
    return PlatformKinematics(wheels)


def changed(wheels, **arrays):
    return replace(wheels, **{key: tuple(value) for key, value in arrays.items()})


@pytest.mark.parametrize("n", COUNTS)
@pytest.mark.parametrize("seed", SEEDS)
def test_rows_equal_ccta_2017_equation_8_in_polar_form(n, seed):
    wheels, model = platform(n, seed)
    for i in range(n):
        length, alpha = math.hypot(wheels.x[i], wheels.y[i]), math.atan2(wheels.y[i], wheels.x[i])
        expected = polar_row(
            length, alpha, wheels.heading[i], wheels.roller_angle[i], wheels.radius[i]
        )
        np.testing.assert_allclose(model.J[i], expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("n", COUNTS)
def test_rigid_motion_causes_no_slip_along_the_roller_axles(n):
    wheels, model = platform(n, 17)
    twist = np.array([0.4, -0.7, 0.9])
    speeds = model.J @ twist
    places = np.stack([wheels.x, wheels.y])
    theta, dt = 0.6, 1e-6

    def contacts(t):
        c, s = math.cos(theta + twist[2] * t), math.sin(theta + twist[2] * t)
        c0, s0 = math.cos(theta), math.sin(theta)
        centre = np.array([c0 * twist[0] - s0 * twist[1], s0 * twist[0] + c0 * twist[1]]) * t
        return centre[:, None] + np.array([[c, -s], [s, c]]) @ places

    velocity = (contacts(dt) - contacts(-dt)) / (2 * dt)
    heading = theta + np.array(wheels.heading)
    axle = heading + np.array(wheels.roller_angle)
    rim = np.array(wheels.radius) * speeds
    floor = velocity - rim * np.stack([np.cos(heading), np.sin(heading)])
    sliding = (floor * np.stack([np.cos(axle), np.sin(axle)])).sum(axis=0)
    np.testing.assert_allclose(sliding, 0, atol=1e-8)


@pytest.mark.parametrize(("a", "b", "r"), [(0.27, 0.36, 0.127), (0.5, 0.2, 0.05), (0.3, 0.3, 1)])
def test_symmetric_platform_has_the_closed_forms_of_ccta_2017(a, b, r):
    model, k = symmetric(a, b, r), a + b
    jacobian = np.array([[1, 1, k], [1, -1, -k], [1, 1, -k], [1, -1, k]]) / r
    constraint = np.array([[1.0, 1, -1, -1]])
    forward = (
        r
        / 4
        * np.array(
            [[1, 1, 1, 1], [1, -1, 1, -1], [1 / k, -1 / k, -1 / k, 1 / k], 4 / r * constraint[0]]
        )
    )
    np.testing.assert_allclose(model.J, jacobian, rtol=1e-12)  # (15)
    np.testing.assert_allclose(model.T / model.T[0, 0], constraint, rtol=1e-12)  # (16)
    np.testing.assert_allclose(abs(model.T), abs(constraint), rtol=1e-12)
    np.testing.assert_allclose(model.J_a_inv[:3], forward[:3], atol=1e-12)  # (17)
    np.testing.assert_allclose(
        model.J_a_inv @ np.hstack([jacobian, constraint.T / 4]), np.eye(4), atol=1e-12
    )  # (18), corrected: the printed 1/r is not the inverse
    assert abs(model.J_a_inv[3] @ (constraint[0] / r)) == pytest.approx(4 / r)


@pytest.mark.parametrize("name", ["omniman", "ig42"])
def test_wheel_order_and_signs_of_the_shipped_robots(name):
    wheels, model = robot(name).wheels, kinematics(name)
    k, r = wheels.x[0] + wheels.y[0], wheels.radius[0]
    assert wheels.names == ("front_left", "front_right", "rear_left", "rear_right")
    expected = np.array([[1, -1, -k], [1, 1, k], [1, 1, -k], [1, -1, k]]) / r
    np.testing.assert_allclose(model.J, expected, rtol=1e-9)
    np.testing.assert_allclose(model.T, [[1, 1, -1, -1]], rtol=1e-9)


@pytest.mark.parametrize("n", COUNTS)
@pytest.mark.parametrize("seed", SEEDS)
def test_augmented_jacobian_is_inverted_and_motions_satisfy_the_constraints(n, seed):
    _, model = platform(n, seed)
    scale = abs(model.J).max()
    np.testing.assert_allclose(model.J_a @ model.J_a_inv, np.eye(n), atol=1e-9 * scale)
    np.testing.assert_allclose(model.J_a_inv @ model.J_a, np.eye(n), atol=1e-9 * scale)
    np.testing.assert_allclose(model.T @ model.J, 0, atol=1e-10 * scale)
    np.testing.assert_allclose(
        model.J_pinv, np.linalg.inv(model.J.T @ model.J) @ model.J.T, rtol=1e-6, atol=1e-9
    )
    np.testing.assert_allclose(model.J_pinv @ model.T_pinv, 0, atol=1e-10)


@pytest.mark.parametrize("name", ALL)
def test_shapes_and_read_only_arrays(name):
    wheels, model = robot(name).wheels, kinematics(name)
    n = len(wheels.names)
    assert (model.wheel_count, model.constraint_count) == (n, n - 3)
    shapes = {
        "J": (n, 3),
        "J_pinv": (3, n),
        "T": (n - 3, n),
        "T_pinv": (n, n - 3),
        "J_a": (n, n),
        "J_a_inv": (n, n),
    }
    for label, shape in shapes.items():
        array = getattr(model, label)
        assert array.shape == shape, label
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert wheel_row(0.1, 0.2, 0, 0.5, 0.1).shape == (3,)


def test_first_three_rows_may_be_linearly_dependent():
    model = kinematics("mecanum6")
    assert np.linalg.matrix_rank(model.J[:3]) == 2  # J_3 of CCTA (10), as printed, is singular
    assert np.linalg.matrix_rank(model.J[list(model.base_wheels)]) == 3
    np.testing.assert_allclose(model.T @ model.J, 0, atol=1e-12)
    rest = [i for i in range(6) if i not in model.base_wheels]
    np.testing.assert_array_equal(model.T[:, rest], -np.eye(3))


def test_random_platform_may_begin_with_three_parallel_rollers():
    rng = np.random.default_rng(5)
    for _ in range(20):
        wheels = random_wheels(rng, 6)
        same = [wheels.roller_angle[0]] * 3 + list(wheels.roller_angle[3:])
        heading = [wheels.heading[0]] * 3 + list(wheels.heading[3:])
        model = PlatformKinematics(changed(wheels, roller_angle=same, heading=heading))
        np.testing.assert_allclose(model.T @ model.J, 0, atol=1e-9)
        assert abs(model.T).max() < 1e6


@pytest.mark.parametrize("seed", SEEDS)
def test_wheel_order_changes_only_the_order_of_the_results(seed):
    wheels, model = platform(5, seed)
    order = np.random.default_rng(seed).permutation(5)
    arrays = {
        key: [getattr(wheels, key)[i] for i in order]
        for key in ("names", "x", "y", "heading", "roller_angle", "radius", "inertia")
    }
    other = PlatformKinematics(changed(wheels, **arrays))
    np.testing.assert_allclose(other.J, model.J[order])
    np.testing.assert_allclose(other.J_pinv, model.J_pinv[:, order], atol=1e-9)
    # The constraints span the same space, whichever rows form J_3.
    np.testing.assert_allclose(
        other.T_pinv @ other.T, (model.T_pinv @ model.T)[order][:, order], atol=1e-8
    )


@pytest.mark.parametrize("gamma", [math.pi / 2, -math.pi / 2, 1.5708, -1.5708, 1.57])
def test_rollers_at_90_degrees_are_rejected_naming_the_wheel(gamma):
    wheels = robot("omniman").wheels
    angles = list(wheels.roller_angle)
    angles[2] = gamma
    with pytest.raises(GeometryError, match=r"'rear_left'.*90 degrees") as caught:
        PlatformKinematics(changed(wheels, roller_angle=angles))
    assert caught.value.wheel == "rear_left"


def rank_two_platforms():
    base = {"names": ("a", "b", "c", "d"), "radius": (0.1,) * 4, "inertia": (0.1,) * 4}
    cross = {"x": (0.3, 0.3, -0.3, -0.3), "y": (0.2, -0.2, 0.2, -0.2)}
    # All wheels roll ahead: no sideways motion.
    yield Wheels(**base, **cross, heading=(0.0,) * 4, roller_angle=(0.0,) * 4)
    # All roller axles meet at the centre: no torque about it.
    towards = tuple(math.atan2(y, x) for x, y in zip(cross["x"], cross["y"], strict=True))
    yield Wheels(**base, **cross, heading=towards, roller_angle=(0.0,) * 4)
    # The "O" arrangement on a square: the wheels cannot turn the platform.
    q = math.pi / 4
    yield Wheels(
        **base,
        x=(0.3, 0.3, -0.3, -0.3),
        y=(0.3, -0.3, 0.3, -0.3),
        heading=(0.0,) * 4,
        roller_angle=(q, -q, -q, q),
    )
    # Four times the same wheel.
    yield Wheels(**base, x=(0.3,) * 4, y=(0.2,) * 4, heading=(0.0,) * 4, roller_angle=(0.5,) * 4)


@pytest.mark.parametrize("wheels", list(rank_two_platforms()))
def test_wheels_that_cannot_drive_all_three_directions_are_rejected(wheels):
    with pytest.raises(GeometryError, match="rank of J < 3") as caught:
        PlatformKinematics(wheels)
    assert caught.value.wheel in wheels.names


def test_error_names_a_wheel_that_adds_no_direction():
    wheels = Wheels(
        names=("ahead", "sideways", "again"),
        x=(0.0, 0.0, 0.0),
        y=(0.0, 0.0, 0.0),
        heading=(0.3, 1.7, 0.3),
        roller_angle=(0.0,) * 3,
        radius=(0.1,) * 3,
        inertia=(0.1,) * 3,
    )
    with pytest.raises(GeometryError, match="2 independent directions") as caught:
        PlatformKinematics(wheels)
    assert caught.value.wheel == "again"


def test_rank_check_does_not_depend_on_the_platform_size():
    wheels = robot("omniman").wheels
    for size in (0.04, 1, 15):
        lengths = {key: size * np.array(getattr(wheels, key)) for key in ("x", "y", "radius")}
        grown = changed(wheels, **{key: array.tolist() for key, array in lengths.items()})
        assert PlatformKinematics(grown).base_wheels == kinematics("omniman").base_wheels


@pytest.mark.parametrize("count", [3, 4, 7])
def test_omni_wheels_all_turn_alike_in_a_rotation_and_the_first_one_to_the_left(count):
    made = PlatformKinematics(Wheels.omni(count=count, distance=0.2, radius=0.05, inertia=0.01))
    assert made.J[:, 2] == pytest.approx(np.full(count, 0.2 / 0.05))
    assert made.J[0, :2] == pytest.approx([0.0, 1.0 / 0.05], abs=1e-12)


# ---- without some wheels ----------------------------------------------------------------------


def subsets(count, *names):
    """Return every choice of `count` wheels of some robots."""
    return [
        (name, subset)
        for name in names
        for subset in itertools.combinations(range(kinematics(name).wheel_count), count)
    ]


def remaining_rank(model, subset):
    return np.linalg.matrix_rank(np.delete(model.J, subset, axis=0), tol=1e-6)


@pytest.mark.parametrize(("name", "pair"), subsets(2, "mecanum6", "mecanum8"))
def test_six_and_eight_wheels_without_any_two_determine_the_twist(name, pair):
    whole = kinematics(name)
    n = whole.wheel_count
    assert remaining_rank(whole, pair) == 3
    assert MIN_REMAINING_FRACTION < whole.remaining_fraction(pair) < 1.0
    left = PlatformKinematics(robot(name).wheels, pair)
    rng = np.random.default_rng(pair)
    twist = rng.uniform(-1, 1, 3)
    speeds = whole.J @ twist
    speeds[list(pair)] = rng.normal(0.0, 10.0, 2)  # wheels that only the floor turns
    np.testing.assert_allclose(left.J_pinv @ speeds, twist, atol=1e-12)
    np.testing.assert_allclose(left.T @ speeds, 0.0, atol=1e-9)
    assert left.T.shape == (n - 3, n)
    assert np.linalg.matrix_rank(left.T) == n - 5
    np.testing.assert_allclose(
        left.T @ left.T_pinv, np.diag([1.0] * (n - 5) + [0.0] * 2), atol=1e-9
    )
    hidden = [i for i in range(n) if i not in pair and remaining_rank(whole, (*pair, i)) < 3]
    assert left.unconstrained == tuple(hidden), "nothing else tells the speed of such a wheel"


@pytest.mark.parametrize(("name", "pair"), subsets(2, "omniman", "ig42", "skewed4"))
def test_four_wheels_without_any_two_do_not_determine_the_twist(name, pair):
    whole = kinematics(name)
    assert remaining_rank(whole, pair) == 2
    assert whole.remaining_fraction(pair) == 0.0


@pytest.mark.parametrize("count", [3, 4, 5])
@pytest.mark.parametrize("name", ["mecanum6", "mecanum8"])
def test_remaining_share_is_zero_exactly_where_the_rank_is_below_three(name, count):
    whole = kinematics(name)
    found = {2: 0, 3: 0}
    for _, subset in subsets(count, name):
        rank = int(remaining_rank(whole, subset))
        if rank < 3:
            assert whole.remaining_fraction(subset) < 1e-9
        else:
            assert 0.01 < whole.remaining_fraction(subset) < 1.0
        found[3 if rank == 3 else 2] += 1
    if (name, count) in {("mecanum6", 3), ("mecanum8", 4), ("mecanum8", 5)}:
        assert found[2] > 0, "wheels with parallel rollers, however many, leave a direction open"


def test_slip_that_no_constraint_shows_is_known():
    wheels = robot("mecanum6").wheels
    for idle, hidden in (((), ()), ((1, 4), ()), ((0, 1), (2,)), ((0, 1, 4), (2, 3, 5))):
        assert PlatformKinematics(wheels, idle).unconstrained == hidden
    assert kinematics("omni3").unconstrained == (0, 1, 2)
    assert kinematics().unconstrained == ()


def test_four_wheels_of_eight_with_parallel_rollers_are_not_a_platform():
    with pytest.raises(GeometryError, match="rank of J < 3"):
        PlatformKinematics(robot("mecanum8").wheels, (0, 3, 4, 7))
