import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build, specs
from omniman_ros.surroundings.obstacles import (
    MAX_VELOCITY_DOUBT,
    PREDICTION_TIME,
    Observation,
    ObstacleParameters,
    ObstacleSet,
)
from test.work import calls

A, B, C = ("people", 1), ("people", 2), ("boxes", 1)


def parameters(**values):
    return build(ObstacleParameters, values)


def obstacles(**values):
    return ObstacleSet(parameters(**values))


def seen(key=A, time=0.0, x=1.0, y=2.0, angle=0.3, semi_axes=(0.5, 0.25), lifetime=0.0):
    return Observation(key, time, x, y, angle, semi_axes, lifetime)


def watch(found, start, end, velocity, key=A, period=0.05, **values):
    """Report an obstacle at constant velocity that is at the origin at time 0."""
    for now in np.arange(start, end - 1e-9, period).tolist():
        place = {"x": now * velocity[0], "y": now * velocity[1]}
        found.add(seen(key, now, **place, **values), now)


# ---- parameters and observations --------------------------------------------------------------


def test_parameters_are_named_within_one_group():
    names = [spec.name for spec in specs(ObstacleParameters, "obstacles.")]
    assert names == [
        "obstacles.noise",
        "obstacles.acceleration",
        "obstacles.growth",
        "obstacles.max_speed",
        "obstacles.timeout",
        "obstacles.required",
        "obstacles.most",
    ]
    made = build(ObstacleParameters, {"obstacles.growth": 0.5, "obstacles.most": 7}, "obstacles.")
    assert (made.tracking.growth, made.most, made.timeout, made.required) == (0.5, 7, 1.0, False)
    with pytest.raises(ParameterError, match="timeout"):
        build(ObstacleParameters, {"timeout": -1.0})


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"time": math.nan}, "time nan"),
        ({"x": math.nan}, "position .*nan"),
        ({"y": math.inf}, "position .*inf"),
        ({"x": -2e6}, "position .*-2000000"),
        ({"angle": math.nan}, "angle .*nan"),
        ({"angle": 1e7}, "angle .*10000000"),
        ({"semi_axes": (0.0, 1.0)}, r"semi-axes \(0.0, 1.0\) m"),
        ({"semi_axes": (1.0, 1e-3)}, "semi-axes"),
        ({"semi_axes": (1.0, -1.0)}, "semi-axes"),
        ({"semi_axes": (math.nan, 1.0)}, r"semi-axes \(nan"),
        ({"semi_axes": (1.0, math.inf)}, "semi-axes"),
        ({"semi_axes": (100.0, 1.0)}, "below 100"),
        ({"lifetime": -0.1}, "lifetime -0.1 s"),
        ({"lifetime": math.nan}, "lifetime nan"),
        ({"lifetime": math.inf}, "lifetime inf"),
        ({"velocity": (0.0, math.nan)}, "velocity .*nan"),
        ({"velocity": (-1e4, 0.0)}, "velocity .*beyond"),
        ({"velocity": (1.0, 0.0), "velocity_deviation": -0.1}, "deviation -0.1"),
        ({"velocity": (1.0, 0.0), "velocity_deviation": math.nan}, "deviation nan"),
    ],
)
def test_implausible_observation_is_refused(change, why):
    with pytest.raises(InputError, match=why):
        replace(seen(), **change)


def test_observation_at_the_limit_of_plausibility_is_accepted():
    found = obstacles()
    found.add(seen(x=1e6, y=-1e6, semi_axes=(99.9, 0.0011)), 0.0)
    assert len(found.ellipses(0.0)) == 1


# ---- ellipses ---------------------------------------------------------------------------------


def test_no_obstacle_gives_no_ellipse():
    made = obstacles().ellipses(3.0)
    assert len(made) == 0 and made.time == 3.0
    assert made.centers.shape == made.semi_axes.shape == (0, 2)


def test_shapes_and_positions_keep_the_order_of_the_obstacles():
    found = obstacles()
    found.add(seen(A, x=1.0, y=2.0, angle=0.1, semi_axes=(0.5, 0.25)), 0.0)
    found.add(seen(B, x=3.0, y=4.0, angle=0.2, semi_axes=(0.6, 0.35)), 0.0)
    found.add(seen(C, x=5.0, y=6.0, angle=0.3, semi_axes=(0.7, 0.45)), 0.0)
    found.add(seen(A, 0.05, x=1.0, y=2.0, angle=0.4, semi_axes=(0.8, 0.55)), 0.05)
    made = found.ellipses(0.05)
    np.testing.assert_allclose(made.centers, [[1, 2], [3, 4], [5, 6]])
    np.testing.assert_allclose(made.semi_axes, [[0.8, 0.55], [0.6, 0.35], [0.7, 0.45]])
    np.testing.assert_allclose(made.angles, [0.4, 0.2, 0.3])
    assert made.velocities.shape == (3, 2) and made.growth.shape == (3,)


def test_heights_follow_the_last_observation():
    found = obstacles()
    found.add(seen(), 0.0)
    found.add(replace(seen(key=B), heights=(0.7, 0.75)), 0.0)
    np.testing.assert_array_equal(found.ellipses(0.0).lower, [-math.inf, 0.7])
    np.testing.assert_array_equal(found.ellipses(0.0).upper, [math.inf, 0.75])
    found.add(replace(seen(time=0.1), heights=(0.0, 0.2)), 0.1)
    np.testing.assert_array_equal(found.ellipses(0.1).upper, [0.2, 0.75])
    with pytest.raises(InputError, match="heights"):
        replace(seen(), heights=(0.2, 0.1))


def test_moving_obstacle_is_extrapolated_to_now():
    found = obstacles()
    watch(found, 0.0, 2.0, (0.8, -0.4))
    for now in (1.95, 2.0, 2.3):
        made = found.ellipses(now)
        assert made.time == now
        assert made.centers[0] == pytest.approx((0.8 * now, -0.4 * now), abs=2e-3)
        assert made.velocities[0] == pytest.approx((0.8, -0.4), abs=2e-3)
    ahead = made.centers_at(np.array([2.8]))
    assert ahead[0, 0] == pytest.approx((0.8 * 2.8, -0.4 * 2.8), abs=3e-3)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5])
def test_margin_of_an_obstacle_grows_with_its_speed(fraction):
    found = obstacles(growth=fraction)
    watch(found, 0.0, 5.0, (1.2, -0.5))
    growth = found.ellipses(5.0).growth[0]
    assert growth == pytest.approx(fraction * 1.3, abs=0.015)
    assert growth > fraction * 1.3


def test_margin_of_a_standing_obstacle_hardly_grows():
    found = obstacles()
    watch(found, 0.0, 5.0, (0.0, 0.0))
    assert 0.0 <= found.ellipses(5.0).growth[0] < 0.01


def test_uncertain_velocity_grows_the_margin_up_to_a_bound():
    found = obstacles()
    found.add(seen(), 0.0)
    assert found.ellipses(0.0).growth[0] == MAX_VELOCITY_DOUBT
    rng = np.random.default_rng(5)
    for now in np.arange(0.05, 3.0, 0.05).tolist():
        found.add(seen(time=now, x=0.03 * rng.normal(), y=0.03 * rng.normal()), now)
    assert 0.02 < found.ellipses(3.0).growth[0] < MAX_VELOCITY_DOUBT


@pytest.mark.parametrize(
    ("values", "coast"), [({}, 1.0), ({"timeout": 0.5}, 0.5), ({"timeout": 0.0}, PREDICTION_TIME)]
)
def test_obstacle_unseen_for_long_stands_where_it_was_last_seen(values, coast):
    found = obstacles(**values)
    watch(found, 0.0, 2.0, (1.0, 0.0))
    last = 1.95
    moving = found.ellipses(last + coast - 0.01)
    assert moving.centers[0] == pytest.approx((last + coast - 0.01, 0.0), abs=0.01)
    standing = found.ellipses(last + coast + 0.01)
    assert standing.centers[0] == pytest.approx((last, 0.0))
    assert not standing.velocities.any() and not standing.growth.any()


def test_returned_ellipses_do_not_change_afterwards():
    found = obstacles()
    watch(found, 0.0, 1.0, (1.0, 0.0))
    before = found.ellipses(1.0)
    kept = before.centers.copy()
    found.add(seen(time=1.0, x=1.0, y=0.0, semi_axes=(3.0, 3.0)), 1.0)
    after = found.ellipses(1.1)
    np.testing.assert_array_equal(before.centers, kept)
    assert (before.semi_axes[0, 0], after.semi_axes[0, 0]) == (0.5, 3.0)
    with pytest.raises(ValueError, match="read-only"):
        before.semi_axes[0, 0] = 9.0


def test_older_observation_is_ignored():
    found = obstacles()
    found.add(seen(time=1.0), 1.0)
    found.add(seen(time=0.9, x=50.0, semi_axes=(9.0, 9.0), lifetime=0.01), 1.05)
    made = found.ellipses(1.5)
    assert made.centers[0] == pytest.approx((1.0, 2.0))
    np.testing.assert_array_equal(made.semi_axes, [[0.5, 0.25]])


def test_single_message_that_moves_an_obstacle_is_accepted_after_a_moment():
    found = obstacles(timeout=0.0)
    watch(found, 0.0, 2.0, (0.0, 0.0))
    found.add(seen(time=2.0, x=7.0, y=7.0), 2.0)
    assert found.ellipses(2.1).centers[0] == pytest.approx((0.0, 0.0))
    for now in (2.4, 100.0):
        assert found.ellipses(now).centers[0] == pytest.approx((7.0, 7.0))


# ---- velocities that are reported --------------------------------------------------------------


def test_reported_velocity_is_used_from_the_first_message_on():
    found = obstacles(growth=0.1)
    found.add(replace(seen(), velocity=(1.2, -0.5), velocity_deviation=0.05), 0.0)
    made = found.ellipses(0.2)
    assert made.centers[0] == pytest.approx((1.24, 1.9))
    assert made.velocities[0] == pytest.approx((1.2, -0.5))
    assert made.growth[0] == pytest.approx(0.1 * 1.3 + 0.05)


def test_reported_turn_has_no_delay_and_no_jump_is_doubted():
    found = obstacles()
    for time, place, velocity in ((0.0, (0.0, 0.0), (1.0, 0.0)), (0.1, (5.0, 0.0), (0.0, -1.0))):
        x, y = place
        found.add(replace(seen(time=time, x=x, y=y), velocity=velocity), time)
    made = found.ellipses(0.3)
    assert made.centers[0] == pytest.approx((5.0, -0.2))
    assert made.velocities[0] == pytest.approx((0.0, -1.0))


def test_reported_velocity_is_bounded_and_uncertain_to_a_bound():
    found = obstacles(max_speed=2.0)
    found.add(replace(seen(), velocity=(6.0, 8.0), velocity_deviation=50.0), 0.0)
    made = found.ellipses(0.0)
    assert made.velocities[0] == pytest.approx((1.2, 1.6))
    assert made.growth[0] == pytest.approx(0.1 * 2.0 + MAX_VELOCITY_DOUBT)


def test_source_may_begin_and_cease_to_report_a_velocity():
    found = obstacles()
    found.add(replace(seen(x=0.0, y=0.0), velocity=(1.0, 0.0)), 0.0)
    found.add(seen(time=0.1, x=0.1, y=0.0), 0.1)
    assert not found.ellipses(0.1).velocities.any()
    watch(found, 0.15, 2.0, (1.0, 0.0))
    assert found.ellipses(2.0).velocities[0] == pytest.approx((1.0, 0.0), abs=0.01)
    found.add(replace(seen(time=2.0, x=2.0, y=0.0), velocity=(-1.0, 0.0)), 2.0)
    assert found.ellipses(2.0).velocities[0] == pytest.approx((-1.0, 0.0))


def test_reported_velocity_does_not_outlive_a_jump_of_time():
    found = obstacles()
    found.add(replace(seen(time=100.0), velocity=(1.0, 0.0)), 100.0)
    made = found.ellipses(3.0)
    assert made.centers[0] == pytest.approx((1.0, 2.0)) and not made.velocities.any()
    assert made.growth[0] == pytest.approx(MAX_VELOCITY_DOUBT)


# ---- expiry and deletion ----------------------------------------------------------------------


def test_obstacle_is_removed_when_its_lifetime_ends():
    found = obstacles()
    found.add(seen(A, lifetime=0.5), 0.0)
    found.add(seen(B, lifetime=0.0), 0.0)
    found.add(seen(C, time=-0.2, lifetime=0.3), 0.0)
    assert [len(found.ellipses(now)) for now in (0.29, 0.31, 0.49, 0.51, 1e6)] == [3, 2, 2, 1, 1]
    assert len(found) == 1


def test_another_observation_extends_a_lifetime_and_may_make_it_unlimited():
    found = obstacles()
    found.add(seen(lifetime=0.5), 0.0)
    found.add(seen(time=0.4, lifetime=0.5), 0.4)
    assert len(found.ellipses(0.8)) == 1
    found.add(seen(time=0.4, lifetime=0.5), 0.8)  # the same stamp sent again
    assert len(found.ellipses(1.2)) == 1
    found.add(seen(time=1.2), 1.2)
    assert len(found.ellipses(1e3)) == 1


def test_obstacle_seen_after_its_lifetime_is_a_new_one():
    found = obstacles()
    watch(found, 0.0, 2.0, (1.0, 0.0), lifetime=0.2)
    found.add(seen(time=2.5, x=2.5, y=0.0), 2.5)
    made = found.ellipses(2.5)
    assert len(made) == 1 and not made.velocities.any()


def test_deletion_removes_one_obstacle_a_namespace_or_all():
    def made():
        found = obstacles()
        for i, key in enumerate((A, B, C)):
            found.add(seen(key, x=float(i)), 0.0)
        assert len(found.ellipses(0.0)) == 3
        return found

    for remove, left in (
        (lambda found: found.delete(B), [0, 2]),
        (lambda found: found.delete(("people", 9)), [0, 1, 2]),
        (lambda found: found.delete_all("people"), [2]),
        (lambda found: found.delete_all(), []),
    ):
        found = made()
        remove(found)
        assert found.ellipses(0.0).centers[:, 0].tolist() == left
        found.add(seen(("new", 0), x=9.0), 0.0)
        assert found.ellipses(0.0).centers[:, 0].tolist() == [*left, 9]


def test_excess_obstacles_are_refused_and_known_ones_are_kept():
    found = obstacles(most=3)
    for i in range(3):
        found.add(seen(("flood", i), x=float(i)), 0.0)
    for _ in range(2):
        with pytest.raises(InputError, match=r"\('flood', 3\).* 3 already, at most 3 are kept"):
            found.add(seen(("flood", 3)), 0.0)
    found.add(seen(("flood", 1), 0.1, x=1.0, semi_axes=(2.0, 2.0)), 0.1)  # a known obstacle
    made = found.ellipses(0.1)
    np.testing.assert_allclose(made.centers[:, 0], [0, 1, 2])
    assert made.semi_axes[1, 0] == 2.0
    found.delete(("flood", 0))
    found.add(seen(("flood", 3)), 0.1)
    assert len(found) == 3


def test_expired_obstacles_make_room():
    found = obstacles(most=1)
    found.add(seen(A, lifetime=0.5), 0.0)
    with pytest.raises(InputError):
        found.add(seen(B), 0.4)
    found.add(seen(B), 0.6)
    assert len(found.ellipses(0.6)) == 1


# ---- the clock -----------------------------------------------------------------


def test_observation_from_the_future_is_refused():
    found = obstacles()
    found.add(seen(time=0.05), 0.0)
    with pytest.raises(InputError, match=r"observed 0\.500 s ahead"):
        found.add(seen(time=0.5), 0.0)
    assert found.ellipses(0.0).centers[0] == pytest.approx((1.0, 2.0))


def test_tracks_restart_when_time_jumps_back():
    found = obstacles()
    watch(found, 100.0, 102.0, (1.0, 0.0), A)
    found.add(seen(B, 101.9, x=5.0, lifetime=0.5), 101.9)
    found.ellipses(3.0)
    made = found.ellipses(3.1)
    np.testing.assert_allclose(made.centers, [[101.95, 0.0], [5.0, 2.0]])
    assert not made.velocities.any()
    assert len(found.ellipses(3.6)) == 1  # the lifetime of B counts from the new time
    found.add(seen(A, 3.6, x=3.6, y=0.0), 3.6)
    watch(found, 3.65, 5.0, (1.0, 0.0), A)
    made = found.ellipses(5.0)
    assert made.velocities[0] == pytest.approx((1.0, 0.0), abs=0.01)


def test_small_backward_step_of_time_is_tolerated():
    found = obstacles()
    watch(found, 0.0, 2.0, (1.0, 0.0))
    made = found.ellipses(1.9)
    assert made.velocities[0] == pytest.approx((1.0, 0.0), abs=0.01)
    assert made.centers[0] == pytest.approx((1.9, 0.0), abs=0.01)


# ---- cost -------------------------------------------------------------------------------------


def test_nothing_is_computed_anew_for_a_thousand_obstacles_that_did_not_change():
    found = obstacles()
    for i in range(1000):
        found.add(seen(("many", i), x=float(i)), 0.0)
    changed = calls(lambda: found.ellipses(0.1))
    assert changed > 1000
    assert calls(lambda: found.ellipses(0.2)) < 150
    found.add(seen(("many", 0), 0.3, x=0.0), 0.3)
    assert calls(lambda: found.ellipses(0.3)) == pytest.approx(changed, rel=0.1)
