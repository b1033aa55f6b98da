"""Tests of `follow_joint_trajectory` goals: their tolerances and their verdict."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from omniman_ros.core import parameters
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.trajectory_goal import (
    Ending,
    ErrorCode,
    GoalMonitor,
    GoalResult,
    GoalTolerances,
    TrajectoryActionOptions,
)

NAMES = ("odom_x", "odom_y", "odom_t", "elbow_joint")
N = len(NAMES)
OPTIONS = TrajectoryActionOptions()
NO_BOUNDS = TrajectoryActionOptions(
    path_tolerance=0.0, goal_tolerance=0.0, stopped_velocity=0.0, goal_time=0.0
)
ZERO = np.zeros(N)
AT_REST = (ZERO, ZERO)
STEP = 0.02


def tolerance(name, position=0.0, velocity=0.0, acceleration=0.0):
    return SimpleNamespace(
        name=name, position=position, velocity=velocity, acceleration=acceleration
    )


def uniform(path=math.inf, goal=math.inf, time=math.inf, speeds=math.inf):
    """Return the same tolerances for all axes; speeds are bounded only at the end."""
    return GoalTolerances(
        np.array([np.full(N, path), np.full(N, math.inf)]),
        np.array([np.full(N, goal), np.full(N, speeds)]),
        time,
    )


def monitor(tolerances=None, goal=ZERO):
    return GoalMonitor(NAMES, np.array(goal, dtype=float), tolerances or uniform(0.1, 0.1, 1.0))


def axis(name, value):
    return np.where(np.array(NAMES) == name, value, 0.0)


def test_unspecified_tolerances_take_the_defaults():
    options = TrajectoryActionOptions(
        path_tolerance=0.3, goal_tolerance=0.2, stopped_velocity=0.1, goal_time=4.0
    )
    got = GoalTolerances.of_goal(NAMES, options, [tolerance("odom_y", velocity=0.7)])
    assert got.path.shape == got.goal.shape == (2, N)
    assert (got.path[0] == 0.3).all() and (got.goal == [[0.2], [0.1]]).all() and got.time == 4.0
    assert got.path[1].tolist() == [math.inf, 0.7, math.inf, math.inf]


def test_a_default_of_zero_means_unbounded():
    got = GoalTolerances.of_goal(NAMES, NO_BOUNDS)
    assert np.isinf(got.path).all() and np.isinf(got.goal).all() and got.time == math.inf


def test_zero_in_a_goal_means_the_default_and_minus_one_unbounded():
    random = np.random.default_rng(3)
    default = GoalTolerances.of_goal(NAMES, OPTIONS)
    for _ in range(200):
        values = random.choice([0.0, -1.0, 1e-9, 0.04, 3.0, math.inf], (2, N, 2))
        time = float(random.choice([0.0, -1.0, 0.5]))
        rows = [
            [tolerance(name, *row) for name, row in zip(NAMES, table, strict=True)]
            for table in values
        ]
        got = GoalTolerances.of_goal(NAMES, OPTIONS, *rows, time=time)
        for table, bounds, usual in zip(
            values, (got.path, got.goal), (default.path, default.goal), strict=True
        ):
            expected = np.where(
                table.T == 0.0, usual, np.where(table.T == -1.0, math.inf, table.T)
            )
            assert (bounds == expected).all()
        assert got.time == {0.0: OPTIONS.goal_time, -1.0: math.inf, 0.5: 0.5}[time]


@pytest.mark.parametrize("value", [-0.5, -1.0001, -math.inf, math.nan])
@pytest.mark.parametrize("field", ["position", "velocity", "acceleration"])
def test_an_invalid_tolerance_is_refused_with_its_axis(value, field):
    bad = tolerance("odom_y", **{field: value})
    for label, given in (("path", {"path": [bad]}), ("goal", {"goal": [bad]})):
        with pytest.raises(InputError, match=f"{label}_tolerance of odom_y: {field}"):
            GoalTolerances.of_goal(NAMES, OPTIONS, **given)


def test_an_invalid_goal_time_is_refused():
    for time in (-0.5, math.nan):
        with pytest.raises(InputError, match="goal_time_tolerance"):
            GoalTolerances.of_goal(NAMES, OPTIONS, time=time)


def test_tolerances_of_unknown_or_repeated_axes_are_refused():
    with pytest.raises(InputError, match="'knee' is for an unknown axis"):
        GoalTolerances.of_goal(NAMES, OPTIONS, [tolerance("knee", 0.1)])
    with pytest.raises(InputError, match="'odom_x' is given twice"):
        GoalTolerances.of_goal(NAMES, OPTIONS, [], [tolerance("odom_x", 0.1)] * 2)


def test_tolerances_are_validated_and_read_only():
    good = np.ones((2, N))
    for path, goal, time in (
        (good[:1], good, 1.0),
        (good, good[:, :2], 1.0),
        (-good, good, 1.0),
        (good, good * math.nan, 1.0),
        (good, good, -1.0),
        (good, good, math.nan),
    ):
        with pytest.raises(InputError, match=r"GoalTolerances|tolerance"):
            GoalTolerances(path, goal, time)
    kept = GoalTolerances(good, good, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        kept.path[0, 0] = 5.0
    assert good.flags.writeable


def test_a_monitor_needs_a_goal_that_names_an_axis():
    with pytest.raises(InputError, match="names no axis"):
        monitor(goal=np.full(N, math.nan))
    with pytest.raises(InputError, match="shape"):
        GoalMonitor(NAMES, np.zeros(2), uniform())


def test_options_have_ranges_and_units():
    assert parameters.build(TrajectoryActionOptions, {}) == OPTIONS
    assert all(spec.unit and spec.low is not None for spec in parameters.specs(type(OPTIONS)))


def test_only_an_axis_beyond_its_path_tolerance_stops_the_motion():
    random = np.random.default_rng(5)
    stopped = 0
    for _ in range(500):
        bounds = 10.0 ** random.uniform(-3, 0, (2, N))
        bounds[random.random((2, N)) < 0.3] = math.inf
        size = np.where(np.isfinite(bounds), bounds, 100.0)
        errors = size * random.uniform(-0.999, 0.999, (2, N))
        errors[0, 2] = math.remainder(errors[0, 2], 2.0 * math.pi)
        watch = GoalMonitor(NAMES, ZERO, GoalTolerances(bounds, np.ones((2, N)), 1.0))
        place = random.uniform(-3, 3, (2, N))
        assert watch.update(0.0, tuple(place), tuple(place - errors), None) is None
        assert not watch.stop
        row, i = random.integers(2), random.integers(N)
        if not math.isfinite(bounds[row, i]):
            continue
        errors[row, i] = random.choice([-1.001, 1.5, 3.0]) * bounds[row, i]
        assert watch.update(1.0, tuple(place), tuple(place - errors), None) is None
        assert watch.stop
        verdict = watch.update(2.0, None, None, "cancelled")
        assert verdict is not None
        assert (verdict.ending, verdict.code) == (
            Ending.ABORTED,
            ErrorCode.PATH_TOLERANCE_VIOLATED,
        )
        assert NAMES[i] in verdict.text and f"{abs(errors[row, i]):.4g}" in verdict.text
        stopped += 1
    assert stopped > 200


def test_a_heading_is_compared_modulo_whole_turns():
    random = np.random.default_rng(7)
    for turns in (-2, -1, 1, 3):
        watch = monitor(uniform(0.1, 0.1, 1.0), axis("odom_t", 4.0))
        wanted = axis("odom_t", random.uniform(-9, 9))
        measured = wanted + axis("odom_t", 2.0 * math.pi * turns + 0.09)
        watch.update(0.0, (wanted, ZERO), (measured, ZERO), None)
        assert not watch.stop
        assert np.allclose(watch.error(wanted, measured), axis("odom_t", -0.09))
        there = axis("odom_t", 4.0 + 2.0 * math.pi * turns)
        verdict = watch.update(0.1, None, (there, ZERO), "")
        assert verdict == GoalResult(Ending.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
        joint = monitor(uniform(0.1))
        turned = axis("elbow_joint", 2.0 * math.pi * turns)
        joint.update(0.0, AT_REST, (turned, ZERO), None)
        assert joint.stop, "a joint position is not compared modulo whole turns"


def test_unknown_axes_violate_no_path_tolerance():
    watch = monitor(uniform(1e-6))
    far = (ZERO + 5.0, ZERO)
    for desired, actual in ((None, far), (far, None), (None, None)):
        assert watch.update(0.0, desired, actual, None) is None
    assert not watch.stop


def test_a_measurement_of_nan_violates_every_finite_bound():
    nothing = (np.full(N, math.nan), np.full(N, math.nan))
    bounded, free = monitor(uniform(0.1)), monitor(uniform())
    bounded.update(0.0, AT_REST, nothing, None)
    free.update(0.0, AT_REST, nothing, None)
    assert bounded.stop and not free.stop


def test_a_goal_ends_when_it_is_reached_or_its_goal_time_elapses():
    random = np.random.default_rng(11)
    endings = []
    for _ in range(300):
        patience = float(random.uniform(0.0, 0.5))
        end, steps = int(random.integers(1, 20)), 60
        off = random.random(steps) < random.choice([0.2, 0.9, 1.0])
        watch = monitor(uniform(math.inf, 0.1, patience, 0.05))
        for k in range(steps):
            bad = axis(random.choice(NAMES), random.choice([-0.11, 0.2]))
            fast = random.random() < 0.5
            actual = (ZERO, bad) if fast else (bad, ZERO)
            outcome = None if k < end else ""
            verdict = watch.update(k * STEP, AT_REST, actual if off[k] else AT_REST, outcome)
            late = (k - end) * STEP
            if k < end:
                assert verdict is None
            elif not off[k]:
                assert verdict == GoalResult(Ending.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
            elif late > patience + 1e-9:
                assert verdict is not None
                assert verdict.code is ErrorCode.GOAL_TOLERANCE_VIOLATED
                assert verdict.ending is Ending.ABORTED
            elif late < patience - 1e-9:
                assert verdict is None
            if verdict is not None:
                endings.append(verdict.ending)
                break
    assert min(endings.count(Ending.SUCCEEDED), endings.count(Ending.ABORTED)) > 50


def test_a_goal_without_a_time_bound_is_awaited_indefinitely():
    watch = monitor(uniform(goal=0.1))
    away = (ZERO + 0.2, ZERO)
    assert all(watch.update(t, None, away, "") is None for t in (0.0, 10.0, 1e6))
    assert watch.update(2e6, None, AT_REST, "").ending is Ending.SUCCEEDED


def test_a_goal_does_not_succeed_without_measurements():
    watch = monitor(uniform(time=1.0))
    assert watch.update(0.0, None, None, "") is None
    verdict = watch.update(1.1, None, None, "")
    assert verdict.code is ErrorCode.GOAL_TOLERANCE_VIOLATED and "not measured" in verdict.text


def test_axes_that_the_goal_omits_are_not_checked():
    watch = monitor(uniform(goal=0.1, time=0.0, speeds=0.1), [math.nan, math.nan, math.nan, 1.0])
    actual = (np.array([5.0, math.nan, 3.0, 1.05]), np.array([1.0, 1.0, 1.0, 0.0]))
    assert watch.update(0.0, None, actual, "").ending is Ending.SUCCEEDED


def test_a_jump_back_in_time_restarts_the_wait():
    watch = monitor(uniform(goal=0.1, time=1.0))
    away = (ZERO + 0.2, ZERO)
    assert watch.update(100.0, None, away, "") is None
    assert watch.update(3.0, None, away, "") is None
    assert watch.update(3.9, None, away, "") is None
    assert watch.update(4.1, None, away, "").code is ErrorCode.GOAL_TOLERANCE_VIOLATED


def test_a_motion_that_ended_early_aborts_the_goal_with_its_reason():
    verdict = monitor().update(0.0, AT_REST, AT_REST, "given up: no odom for 0.20 s")
    expected = GoalResult(Ending.ABORTED, ErrorCode.INVALID_GOAL, "given up: no odom for 0.20 s")
    assert verdict == expected


@pytest.mark.parametrize("outcome", ["cancelled", "", "given up: emergency_stop is true"])
def test_a_cancelled_goal_is_canceled_whatever_ended_its_motion(outcome):
    watch = monitor()
    watch.cancel()
    assert watch.stop
    assert watch.update(0.0, AT_REST, (ZERO + 9.0, ZERO), None) is None
    verdict = watch.update(1.0, AT_REST, AT_REST, outcome)
    assert (verdict.ending, verdict.code) == (Ending.CANCELED, ErrorCode.SUCCESSFUL)
    assert outcome in verdict.text and verdict.text


def test_a_violation_before_a_cancel_is_reported_to_the_client():
    watch = monitor()
    watch.update(0.0, AT_REST, (axis("odom_x", 0.2), ZERO), None)
    watch.cancel()
    verdict = watch.update(1.0, AT_REST, AT_REST, "cancelled")
    assert verdict.code is ErrorCode.PATH_TOLERANCE_VIOLATED
    assert "0.2 m from its reference, at most 0.1 m" in verdict.text
