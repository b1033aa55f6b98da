"""The choice among motions: on the platform's check, and on one of a single coordinate."""

import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.motion_choice import GAP_GAIN, MotionChooser
from omniman_ros.planning.safety import Surroundings
from test.planning.support import ellipses, true_gaps
from test.planning.test_safety import (
    DECELERATION,
    HALF,
    NOW,
    WIDE,
    a_line,
    a_motion,
    around,
    closest,
    some_obstacles,
)


def braked(motion, time):
    return motion.braked(time, DECELERATION)


def longest(check, motion, earliest):
    """Return the longest clear part of a motion."""
    return MotionChooser(check, braked, NOW, NOW).longest(motion, earliest)


def by_brute_force(surroundings, motion, earliest):
    """Return the latest node at which braking is clear."""
    whole = motion.braked(motion.end, DECELERATION)
    if surroundings.contact(whole, NOW) == math.inf:
        return whole
    for time in motion.times[motion.times >= earliest][::-1]:
        shorter = motion.braked(float(time), DECELERATION)
        if surroundings.contact(shorter, NOW) == math.inf:
            return shorter
    return None


def test_latest_braking_that_is_clear_is_found():
    random = np.random.default_rng(2)
    shortened = none = 0
    for _ in range(60):
        motion, known = a_motion(random), some_obstacles(random)
        surroundings = around(known)
        found = longest(surroundings, motion, NOW + 0.05)
        expected = by_brute_force(surroundings, motion, NOW + 0.05)
        assert (found is None) == (expected is None)
        if found is None or expected is None:
            none += 1
            continue
        assert found.end == pytest.approx(expected.end)
        np.testing.assert_allclose(found.poses[-1], expected.poses[-1])
        np.testing.assert_array_equal(found.velocities[-1], 0.0)
        shortened += found.end < motion.end
        if true_gaps(np.array([NOW]), motion.poses[:1], HALF, known).min() > 0.05:
            assert closest(found, known).min() > 0.0
    assert shortened > 8 and none > 2


def test_earlier_braking_may_lead_to_contact():
    # An obstacle crosses where early braking would leave the robot; a wall is ahead.
    motion = a_line(0.8, 0.0, 0.0)
    known = ellipses(
        (0.5, 3.5, 0.35), (2.4, 0.0, 0.2, 3.0, 0.0), time=NOW, velocities=[(0, -1.6), (0, 0)]
    )
    surroundings = Surroundings(Footprint(Rectangles.centred(HALF)), known, WIDE, 0.02, NOW + 4.0)
    for late in (0.1, 0.5):
        early = motion.braked(NOW + late, DECELERATION)
        assert surroundings.contact(early, NOW) < math.inf
    found = longest(surroundings, motion, NOW + 0.05)
    assert found is not None
    assert closest(found, known).min() > 0.0


def test_no_part_is_found_where_none_is_clear():
    ahead = around(ellipses((0.75, 0.0, 0.3)))
    assert longest(ahead, a_line(0.9, 0.0, 0.0), NOW + 0.05) is None


def test_free_motion_is_kept_and_braked_at_its_end():
    motion = a_line(0.6, 0.1, 0.2)
    found = longest(around(), motion, NOW + 0.05)
    assert found is not None and found.end == pytest.approx(motion.end + np.hypot(0.6, 0.1) / 1.5)


# ---- the choice -------------------------------------------------------------------------------


class Wall:
    """A check of one coordinate: contact is where it reaches a place, a threat by its rates."""

    def __init__(self, place, threats=None):
        self.place, self.threats = place, threats

    def contact(self, motion, now):
        times = np.linspace(now, max(motion.end, now), 400)
        reached = motion.at(times)[0][:, 0] >= self.place
        return float(times[reached.argmax()]) if reached.any() else math.inf

    def threat(self, motion, now):
        return self.threats(motion)


def along(speed, *, begin=0.0, start=NOW, seconds=2.0):
    """Return a motion of one coordinate at a speed."""
    times = np.arange(0.0, seconds + 1e-9, 0.1)
    rates = np.full((len(times), 1), speed)
    return HermiteTrajectory(
        start + times, begin + speed * times[:, None], rates, np.zeros((len(times) - 1, 0))
    )


def stopped(motion, time):
    """Brake within half a second, whatever the speed."""
    position, rate = motion.sample(time)
    elapsed = np.linspace(0.0, 0.5, 6)[:, None]
    tail = HermiteTrajectory(
        time + elapsed[:, 0],
        position + rate * (elapsed - elapsed**2),
        rate * (1.0 - 2.0 * elapsed),
        np.zeros((5, 0)),
    )
    return tail if time <= motion.start else motion.between(motion.start, time).then(tail)


def test_a_clear_plan_goes_before_the_last_motion_and_that_before_braking():
    last = along(0.1, seconds=3.0)
    chooser = MotionChooser(Wall(1.0), stopped, NOW, NOW + 0.02)
    best = chooser.choose([along(0.8), along(0.2)], NOW + 0.3, last, None)
    assert best.plan == 0 and best.is_clear and 0.8 < best.motion.poses[-1, 0] < 1.0
    best = chooser.choose([along(5.0), along(0.2)], NOW + 0.3, last, None)
    assert best.plan == 1, "no part of the first is clear"
    best = chooser.choose([along(5.0)], NOW + 0.3, last, None)
    assert best.plan is None and best.motion is last
    best = chooser.choose([along(5.0)], NOW + 0.3, along(0.8), None)
    assert best.is_braking and best.is_clear and best.motion.poses[-1, 0] < 1.0


def test_no_motion_brakes_before_the_choice_takes_over():
    chooser = MotionChooser(Wall(0.0, lambda _: (NOW, -1.0)), stopped, NOW, NOW + 0.04)
    best = chooser.choose([], NOW + 0.3, along(0.8), None)
    assert best.is_braking and not best.is_clear
    assert best.motion.sample(NOW + 0.04)[1][0] == pytest.approx(0.8)
    assert best.motion.sample(NOW + 0.06)[1][0] < 0.8


@pytest.mark.parametrize(
    ("delay", "gain", "evades"),
    [
        (0.15, 0.0, True),
        (0.05, 0.0, False),
        (0.0, 2 * GAP_GAIN, True),
        (0.0, 0.5 * GAP_GAIN, False),
    ],
)
def test_who_moves_on_towards_a_contact_has_a_reason_and_keeps_to_it(delay, gain, evades):
    """Braking is left for a contact that is later by a tenth of a second, or a wider gap."""
    plan, end = along(0.8), NOW + 1.0

    def threats(motion):
        is_braking = motion.sample(NOW + 0.5)[1][0] < 0.5
        return (end, 0.0) if is_braking else (end + delay, gain)

    chooser = MotionChooser(Wall(-1.0, threats), stopped, NOW, NOW)
    best = chooser.choose([plan], NOW + 0.3, along(0.0), None)
    assert (best.plan == 0) is evades
    again = chooser.choose([plan], NOW + 0.3, best.motion, best)
    assert (again.plan == 0) is evades
    delay = -0.05  # an evasion goes on although its contact comes a little sooner
    assert (chooser.choose([plan], NOW + 0.3, best.motion, best).plan == 0) is evades


def test_few_brakings_are_tried_where_a_check_is_costly():
    asked = []
    wall = Wall(1.0)
    contact = wall.contact
    wall.contact = lambda motion, now: asked.append(motion.end) or contact(motion, now)
    found = MotionChooser(wall, stopped, NOW, NOW, attempts=3).longest(along(5.0), NOW + 0.1)
    assert found is None and len(asked) <= 4
    asked.clear()
    found = MotionChooser(wall, stopped, NOW, NOW, attempts=3).longest(along(0.7), NOW + 0.1)
    assert found is not None and len(asked) <= 4


def test_among_people_only_a_motion_without_contact_is_an_evasion():
    class Check:
        """Nothing is clear; contact comes later on plans than on braking, or never."""

        def __init__(self, later):
            self.later = later

        def contact(self, motion, now):
            return now

        def threat(self, motion, now):
            goes_on = motion.poses[-1, 0] > 1.0
            return (self.later if goes_on else NOW + 0.2), 0.0

    last, plan = a_line(0.5, 0.0, 0.0), a_line(0.9, 0.0, 0.0)
    for later, evades in ((NOW + 2.0, False), (math.inf, True)):
        chooser = MotionChooser(Check(later), braked, NOW, NOW, evades_contact=False)
        choice = chooser.choose([plan], NOW + 0.05, last, None)
        assert choice.is_evasion is evades and choice.is_braking is not evades
    always = MotionChooser(Check(NOW + 2.0), braked, NOW, NOW)
    assert always.choose([plan], NOW + 0.05, last, None).is_evasion
