import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.planner import PathPlanner
from omniman_ros.motion.path.trajectory import Trajectory
from test.motion.path.support import (
    DT,
    assert_smooth_within_limits,
    axes,
    fractions,
    off_path,
    planned,
    random_path,
)

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 1], [0, 2, 1], [0, 0, 0]], dtype=float)


@pytest.mark.parametrize("seed", range(40))
def test_limits_hold_everywhere_and_both_ends_are_exact(seed):
    points = random_path(seed)
    _, trajectory = planned(points)
    assert_smooth_within_limits(
        axes(), trajectory.positions, trajectory.velocities, trajectory.accelerations
    )
    assert trajectory.positions[0] == pytest.approx(points[0], abs=1e-12)
    assert (trajectory.positions[-1] == points[-1]).all()
    assert not trajectory.velocities[-1].any() and not trajectory.accelerations[-1].any()


@pytest.mark.parametrize("seed", range(40))
def test_corners_are_cut_within_the_tolerance(seed):
    points = random_path(seed)
    points[:, 2] = 0.0
    _, trajectory = planned(points)
    assert off_path(trajectory.positions, points).max() <= 0.05 + 1e-9
    # Every pose of the path is also passed within the tolerance, in order.
    last = 0
    for point in points:
        near = np.hypot(*(trajectory.positions[last:, :2] - point[:2]).T) <= 0.05 * 1.001
        assert near.any()
        last += int(near.argmax())


@pytest.mark.parametrize("distance", [0.1, 0.5, 2.0, 10.0])
def test_a_straight_line_takes_little_more_than_the_minimum_time(distance):
    """The minimum with a jerk limit is known: seven phases, each at a limit of v, a or j."""
    plan, _ = planned([[0, 0, 0], [distance, 0, 0]])
    v, a, j = 0.5, 0.8, 8.0
    if distance >= v * v / a + v * a / j:
        least = distance / v + v / a + a / j
    else:
        peak = (-a / j + np.sqrt((a / j) ** 2 + 4 * distance / a)) / 2 * a
        least = 2 * (peak / a + a / j)
    assert least - 1e-9 <= plan.duration <= least + a / j + 4 * DT


def test_the_duration_of_a_path_with_corners_is_near_its_bound():
    plan, _ = planned(SQUARE)
    assert 1.0 < plan.duration / plan.bound < 1.02
    longest = 8.0 / 0.5 + 0.5 / 0.8
    assert plan.duration < 1.1 * longest


def test_the_limits_are_exploited():
    used = fractions(axes(), None, *_derivatives(planned(SQUARE)[1]))
    assert used["velocity"] > 0.999 and used["acceleration"] > 0.99


def _derivatives(trajectory):
    return trajectory.velocities, trajectory.accelerations


@pytest.mark.parametrize("tolerances", [(0.0, 0.1), (0.0, 0.0)])
def test_without_tolerance_the_robot_stops_exactly_at_each_corner(tolerances):
    _, trajectory = planned(SQUARE, axes(*tolerances))
    for corner in SQUARE[1:-1]:
        off = np.abs(trajectory.positions - corner).max(axis=1)
        assert off.min() < 1e-9
        assert np.abs(trajectory.velocities[off.argmin()]).max() < 1e-9
    assert off_path(trajectory.positions, SQUARE).max() < 1e-9


def test_without_heading_tolerance_the_robot_stops_only_where_the_turn_rate_changes():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 1]], dtype=float)
    plan, trajectory = planned(points, axes(0.05, 0.0))
    assert len(plan.route.curves) == 2
    at = np.abs(trajectory.positions - points[2]).max(axis=1).argmin()
    assert np.abs(trajectory.velocities[at]).max() < 1e-9


@pytest.mark.parametrize("tolerances", [(0.05, 0.0), (0.0, 0.1)])
@pytest.mark.parametrize("seed", range(5))
def test_a_zero_tolerance_of_one_group_does_not_affect_the_other(tolerances, seed):
    points = random_path(seed)
    points[:, 2] = 0.0
    plan, trajectory = planned(points, axes(*tolerances))
    assert_smooth_within_limits(
        axes(), trajectory.positions, trajectory.velocities, trajectory.accelerations
    )
    assert off_path(trajectory.positions, points).max() <= tolerances[0] + 1e-9
    if tolerances[0]:
        assert len(plan.route.curves) == 1, "a path without turns has no stop"


@pytest.mark.parametrize("size", [0.001, 0.01, 0.04, 0.1])
def test_a_path_there_and_back_is_driven_or_refused(size):
    """A path that is smaller than the tolerance may leave nothing to drive."""
    points = np.array([[0, 0, 0], [size, 0, 0], [0, 0, 0]], dtype=float)
    try:
        _, trajectory = planned(points)
    except InputError as error:
        assert "nothing to drive" in str(error) and size < 0.05
    else:
        assert np.abs(trajectory.positions[-1]).max() == 0.0
        assert trajectory.positions[:, 0].max() > size - 0.05


def test_a_larger_tolerance_is_faster():
    times = [planned(SQUARE, axes(tolerance))[0].duration for tolerance in (0.0, 0.01, 0.05, 0.3)]
    assert times == sorted(times, reverse=True) and times[0] > times[-1] + 2.0


def test_a_dense_circle_is_followed_as_a_circle():
    phase = np.linspace(0, 2 * np.pi, 1000)
    _, trajectory = planned(np.column_stack([np.cos(phase), np.sin(phase), 0 * phase]))
    radius = np.hypot(*trajectory.positions[:, :2].T)
    assert np.abs(radius - 1.0).max() < 0.008
    assert np.abs(trajectory.velocities[300:-300, :2]).max() > 0.45


def test_stairs_within_the_tolerance_are_driven_as_a_straight_line():
    k = np.arange(200)
    stairs = np.column_stack([0.04 * ((k + 1) // 2), 0.04 * (k // 2), 0 * k]).astype(float)
    plan, trajectory = planned(stairs)
    straight, _ = planned(stairs[[0, -1]])
    assert plan.duration < 1.1 * straight.duration
    assert off_path(trajectory.positions, stairs).max() <= 0.05


def test_noise_on_a_path_costs_little_time():
    rng = np.random.default_rng(1)
    line = np.linspace([0, 0, 0], [5, 0, 0], 500)
    noisy = line + rng.normal(size=line.shape) * [2e-3, 2e-3, 2e-3]
    noisy[[0, -1]] = line[[0, -1]]
    assert planned(noisy)[0].duration < 1.1 * planned(line)[0].duration


def test_a_speed_cap_also_holds_for_the_smoothed_motion():
    wheels = np.array([[1, -1, -0.4], [1, 1, 0.4], [1, 1, -0.4], [1, -1, 0.4]]) / 0.1

    def cap(q, slope):
        return 5.0 / np.maximum(np.abs(slope @ wheels.T).max(axis=1), 1e-9)

    points = np.array([[0, 0, 0], [1, 1, 2], [2, 0, 0]], dtype=float)
    _, trajectory = planned(points, cap=cap)
    assert np.abs(trajectory.velocities @ wheels.T).max() <= 5.0 * 1.005


def test_empty_and_overlong_paths_are_refused():
    planner = PathPlanner(axes(), DT)
    with pytest.raises(InputError, match="nothing to drive"):
        planner.plan(np.zeros((3, 3)))
    with pytest.raises(InputError, match="at most 3600 s"):
        planner.plan(np.array([[0, 0, 0], [1e6, 0, 0]]))


@pytest.mark.parametrize("count", [2, 100, 10_000])
def test_progress_goes_from_0_to_1(count):
    phase = np.linspace(0, 6 * np.pi, count)
    points = np.column_stack([0.3 * phase * np.cos(phase), 0.3 * phase * np.sin(phase), 0 * phase])
    plan, trajectory = planned(points)
    assert plan.ticks.progress[0] == 0.0 and plan.ticks.progress[-1] == 1.0
    assert (np.diff(plan.ticks.progress) >= 0).all()
    assert trajectory.progress(trajectory.end + 5.0) == 1.0


def test_a_plan_from_a_moving_start_continues_its_velocity():
    planner = PathPlanner(axes(), DT)
    velocity = np.array([0.3, 0.2, -0.5])
    plan = planner.plan_on(np.array([1.0, 2.0, 0.5]), velocity, np.array([[0.0, 0.0, 0.0]]))
    first = np.diff(plan.ticks.positions[:3], axis=0) / DT
    assert first[0] == pytest.approx(velocity, abs=1.2 * DT)
    assert (plan.ticks.positions[0] == [1.0, 2.0, 0.5]).all()


def test_arm_and_platform_share_one_time_base():
    from omniman_ros.motion.path.axis_group import AxisGroup

    joints = [AxisGroup((3 + i,), 1.5, 3.0, 30.0, 0.05) for i in range(6)]
    groups = (*axes(), *joints)
    points = np.random.default_rng(2).normal(size=(5, 9))
    planner = PathPlanner(groups, DT)
    plan = planner.plan(points)
    trajectory = Trajectory(0.0, DT, plan.ticks, planner.smoother)
    assert_smooth_within_limits(
        groups, trajectory.positions, trajectory.velocities, trajectory.accelerations
    )
    assert (trajectory.positions[-1] == points[-1]).all()


def test_the_smoothing_at_stops_counts_towards_the_longest_duration():
    """With a low jerk limit each of 100 stops would last minutes, which is millions of ticks."""
    zigzag = np.array([[i, i % 2, 0.0] for i in range(100)], dtype=float)
    with pytest.raises(InputError, match="the path takes over"):
        planned(zigzag, axes(tolerance=0.0, jerk=0.01))
