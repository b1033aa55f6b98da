import numpy as np
import pytest

from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.curve import Curve
from omniman_ros.motion.path.time_profile import TimeProfiler
from test.motion.path.support import axes, random_path

GROUPS = axes()


def curve_of(points):
    points = np.asarray(points, dtype=float)
    keep = np.concatenate([[True], np.abs(np.diff(points, axis=0)).max(1) > 1e-6])
    return Curve(points[keep], GROUPS, [0.05, 0.1])


def largest_used_fraction(curve, profile, samples=5):
    """Return the largest used fraction of the limits, at the nodes and between them."""
    u = np.linspace(profile.nodes[:-1] + 1e-12, profile.nodes[1:] - 1e-12, samples)
    fraction = (u - profile.nodes[:-1]) / np.diff(profile.nodes)
    square = profile.squares[:-1] + fraction * np.diff(profile.squares)
    rate = 0.5 * np.diff(profile.squares) / np.diff(profile.nodes)
    used = 0.0
    for row in range(samples):
        slope = curve.slope(u[row])
        bend = curve.bends[curve.piece(u[row])]
        acceleration = slope * rate[:, None] + bend * square[row][:, None]
        for g in GROUPS:
            used = max(used, float((g.norm(acceleration) / g.acceleration).max()))
    return used, float(np.sqrt(profile.squares.max()))


@pytest.mark.parametrize("distance", [1e-4, 0.01, 0.1, 1.0, 20.0])
def test_a_straight_line_takes_the_minimum_time(distance):
    profile = TimeProfiler(GROUPS).fastest(curve_of([[0, 0, 0], [distance, 0, 0]]))
    v, a = 0.5, 0.8
    ramp = v * v / a
    least = 2 * np.sqrt(distance / a) if distance < ramp else distance / v + v / a
    assert profile.duration == pytest.approx(least, rel=0.01)
    assert profile.duration >= least - 1e-9


def test_a_turn_in_place_is_timed_by_the_heading():
    profile = TimeProfiler(GROUPS).fastest(curve_of([[0, 0, 0], [0, 0, 3.0]]))
    assert profile.duration == pytest.approx(3.0 / 1.2 + 1.0, rel=0.01)


def test_a_parabola_is_driven_at_its_permitted_speed():
    """The corner needs the full acceleration at the speed that the parabola permits."""
    points = np.array([[0, 0, 0], [3, 0, 0], [3, 3, 0]], dtype=float)
    curve = Curve(points, GROUPS, [0.01, 0.1])
    profile = TimeProfiler(GROUPS).fastest(curve)
    u, rate = profile.at(np.linspace(0, profile.duration, 5000))
    middle = 3.0 / 0.5
    at_corner = np.interp(middle, u, rate) * np.linalg.norm(curve.slope(np.array([middle]))[0])
    bend = np.linalg.norm(curve.bends[curve.piece(np.array([middle]))[0]])
    assert np.interp(middle, u, rate) ** 2 * bend == pytest.approx(0.8, rel=0.02)
    assert 0.1 < at_corner < 0.5


@pytest.mark.parametrize("seed", range(30))
def test_limits_hold_at_both_ends_of_each_cell_and_between_them(seed):
    curve = curve_of(random_path(seed))
    profile = TimeProfiler(GROUPS).fastest(curve)
    acceleration, speed = largest_used_fraction(curve, profile)
    assert acceleration <= 1.0 + 1e-6
    assert speed <= 1.0 + 1e-9
    assert profile.squares[0] == profile.squares[-1] == 0.0
    assert acceleration > 0.999, "time-optimal: some limit is always reached"


@pytest.mark.parametrize("seed", range(8))
def test_no_node_can_be_passed_faster(seed):
    """Each u'^2 is maximal: with its neighbours fixed, it cannot be raised at any node."""
    curve = curve_of(random_path(seed, 6))
    profile = TimeProfiler(GROUPS).fastest(curve)
    nodes, squares = profile.nodes, profile.squares.copy()
    spans = np.diff(nodes)
    slopes = curve.slope(nodes)
    bends = curve.bends[curve.piece(0.5 * (nodes[1:] + nodes[:-1]))]

    def allowed(i):
        rate = 0.5 * (squares[i + 1] - squares[i]) / spans[i]
        for j in (i, i + 1):
            acceleration = slopes[j] * rate + bends[i] * squares[j]
            if any(g.norm(acceleration) > g.acceleration * (1 + 1e-7) for g in GROUPS):
                return False
        return True

    for i in range(1, len(nodes) - 1):
        before = squares[i]
        squares[i] = before * 1.002 + 1e-9
        possible = squares[i] <= 1.0 and allowed(i - 1) and allowed(i)
        squares[i] = before
        assert not possible, f"node {i} of {len(nodes)} could be faster"


@pytest.mark.parametrize("seed", range(20))
def test_a_stop_from_anywhere_keeps_the_limits_and_ends_before_the_path(seed):
    curve = curve_of(random_path(seed))
    profiler = TimeProfiler(GROUPS)
    profile = profiler.fastest(curve)
    for fraction in np.linspace(0.02, 0.98, 9):
        u, rate = (float(x[0]) for x in profile.at(np.array([fraction * profile.duration])))
        stop = profiler.quickest_stop(curve, u, rate)
        assert largest_used_fraction(curve, stop)[0] <= 1.0 + 1e-6
        assert stop.duration <= (1 - fraction) * profile.duration + 1e-6
        assert stop.nodes[0] == u and stop.squares[0] == rate * rate and stop.squares[-1] == 0.0
        assert stop.nodes[-1] <= curve.end + 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_continuing_from_any_point_gives_the_same_motion(seed):
    curve = curve_of(random_path(seed))
    profiler = TimeProfiler(GROUPS)
    profile = profiler.fastest(curve)
    for fraction in (0.1, 0.35, 0.6, 0.9):
        u, rate = (float(x[0]) for x in profile.at(np.array([fraction * profile.duration])))
        rest = profiler.fastest(curve, u, rate)
        assert rest is not None
        assert rest.duration == pytest.approx(
            (1 - fraction) * profile.duration, rel=1e-3, abs=1e-4
        )


def test_a_speed_too_high_to_stop_is_reported():
    curve = curve_of([[0, 0, 0], [0.01, 0, 0]])
    assert TimeProfiler(GROUPS).fastest(curve, 0.0, 1.0) is None


def test_a_speed_cap_is_kept():
    curve = curve_of([[0, 0, 0], [2, 0, 0]])
    cap = TimeProfiler(GROUPS, lambda q, slope: np.where(q[:, 0] > 1.0, 0.25, 1.0))
    profile = cap.fastest(curve)
    u, rate = profile.at(np.linspace(0, profile.duration, 2000))
    there = curve.at(u)[:, 0] > 1.0 + 0.5 * 0.02  # at most one cell later
    assert rate[there].max() <= 0.25 + 1e-9 < rate[~there].max()


def test_further_axes_share_the_time_base_of_the_platform():
    """Six joints with their own limits lie on one curve with the platform."""
    joints = [AxisGroup((3 + i,), 1.0 + 0.3 * i, 2.0 + i, 40.0, 0.02) for i in range(6)]
    groups = [*GROUPS, *joints]
    rng = np.random.default_rng(5)
    curve = Curve(rng.normal(size=(6, 9)), groups, [g.tolerance for g in groups])
    profile = TimeProfiler(groups).fastest(curve)
    u, rate = profile.at(np.linspace(0, profile.duration, 4000))
    velocity = curve.slope(u) * rate[:, None]
    dt = profile.duration / 3999
    acceleration = np.diff(velocity, axis=0) / dt
    for g in groups:
        assert g.norm(velocity).max() <= g.velocity * (1 + 1e-6)
        assert g.norm(acceleration).max() <= g.acceleration * (1 + 1e-3)


def test_a_motion_continues_within_a_cell_whose_cap_is_lower_inside():
    def cap(q, slope):
        return 0.3 + 2.0 * (q[:, 0] - 0.5) ** 2

    groups = axes(acceleration=50.0)
    curve = Curve(np.array([[0.0, 0, 0], [1.0, 0, 0]]), groups, [0.05, 0.1])
    profiler = TimeProfiler(groups, cap)
    profile = profiler.fastest(curve)
    for time in np.linspace(0.1, 0.9, 50) * profile.duration:
        u, rate = (float(value[0]) for value in profile.at(np.array([time])))
        again = profiler.fastest(curve, u, rate)
        assert again is not None
        assert again.duration == pytest.approx(profile.duration - time, abs=1e-3)
