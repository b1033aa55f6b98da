import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.pace import LEAD, LimitUsage, Pace
from omniman_ros.motion.path.trajectory import Trajectory
from test.motion.path.support import DT, axes, planned, random_path


def unlimited_pace() -> Pace:
    return Pace(lambda times: LimitUsage.none(len(times)), DT)


def pace_over(trajectory: Trajectory, groups: tuple[AxisGroup, ...]) -> Pace:
    return Pace(lambda times: LimitUsage.of(groups, *trajectory.sample(times)[1:]), DT)


def test_motion_time_equals_real_time_until_a_pace_is_requested():
    pace, times = unlimited_pace(), np.array([3.0, 4.1])
    assert pace.plain and (pace.sample(times).motion == times).all()
    pace.aim(1.0, 2.0)
    pace.refresh(3.0)
    assert pace.plain


def test_a_change_of_pace_begins_after_the_lead_and_ends_exactly_at_its_target():
    pace = unlimited_pace()
    pace.aim(0.3, 10.0)
    times = 10.0 + 0.001 * np.arange(1000)
    got = pace.sample(times)
    begin = times[np.flatnonzero(got.rate < 1.0)[0]] - 10.0
    assert LEAD * DT - 1e-9 <= begin <= (LEAD + 1) * DT
    assert (np.diff(got.rate) <= 1e-12).all() and got.rate[-1] == 0.3
    assert np.diff(got.motion) / 0.001 == pytest.approx(
        0.5 * (got.rate[1:] + got.rate[:-1]), abs=0.02
    )
    assert pace.motion(30.0) - pace.motion(20.0) == pytest.approx(3.0)


def test_a_pace_of_zero_stops_motion_time_until_it_is_raised():
    pace = unlimited_pace()
    pace.aim(0.0, 1.0)
    assert not pace.stands(1.1) and pace.stands(pace.settling(1.0))
    place = pace.motion(5.0)
    assert pace.motion(9.0) == place
    pace.aim(1.0, 9.0)
    assert pace.motion(9.0 + LEAD * DT) == pytest.approx(place, abs=1e-12)
    assert pace.rate(pace.settling(9.0)) == 1.0
    pace.reset(20.0, 1.0)
    assert pace.plain


def test_motion_within_the_lead_is_not_changed():
    pace = unlimited_pace()
    pace.aim(0.2, 1.0)
    times = 1.1 + 0.001 * np.arange(24)
    before = pace.sample(times).motion.copy()
    pace.aim(0.9, 1.1)
    assert (pace.sample(times).motion == before).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_acceleration_limits_hold_for_any_course_of_the_pace(seed):
    groups = axes()
    _, trajectory = planned(random_path(seed), groups)
    pace, rng, now = pace_over(trajectory, groups), np.random.default_rng(seed), 0.0
    rows = []
    while pace.motion(now) < trajectory.end and now < 30.0:
        pace.refresh(now)
        if rng.random() < 0.4:
            target, at_once = float(rng.choice([0.0, 0.2, 0.5, 0.9, 1.0])), rng.random() < 0.3
            pace.aim(target, now, at_once=bool(at_once))
        times = now + 0.002 * np.arange(round(0.2 / 0.002))
        paced = pace.sample(times)
        assert (paced.rate >= 0.0).all() and (paced.rate <= 1.0).all()
        rows.append(np.hstack(paced.apply(*trajectory.sample(paced.motion))))
        now += 0.2
    x, v, a = np.split(np.vstack(rows), 3, axis=1)
    for group in groups:
        assert group.norm(v).max() <= group.velocity * (1 + 1e-6)
        assert group.norm(a).max() <= group.acceleration * (1 + 1e-6)
    assert np.abs(np.diff(x, axis=0) / 0.002 - 0.5 * (v[1:] + v[:-1])).max() < 5e-3


@pytest.mark.parametrize("target", [0.0, 0.5])
def test_slowing_down_takes_little_longer_than_the_acceleration_limit_requires(target):
    groups = axes()
    _, trajectory = planned([[0, 0, 0], [3, 0, 0]], groups)
    pace = pace_over(trajectory, groups)
    pace.aim(target, 2.0)
    speed, group = 0.5, groups[0]
    least = (1.0 - target) * speed / group.acceleration
    took = pace.settling(2.0) - 2.0
    assert least <= took <= 1.05 * least + group.acceleration / group.jerk + (LEAD + 3) * DT


def test_a_pace_that_falls_at_once_begins_without_regard_to_the_jerk():
    groups = axes()
    _, trajectory = planned([[0, 0, 0], [3, 0, 0]], groups)
    begins = []
    for at_once in (False, True):
        pace = pace_over(trajectory, groups)
        pace.aim(0.0, 2.0, at_once=at_once)
        times = 2.0 + 0.001 * np.arange(1000)
        begins.append(times[np.flatnonzero(pace.sample(times).rate < 0.95)[0]] - 2.0)
    speed, group = 0.5, groups[0]
    least = LEAD * DT + 0.05 * speed / group.acceleration
    assert begins[0] > begins[1] and begins[1] == pytest.approx(least, abs=2.5 * DT)
