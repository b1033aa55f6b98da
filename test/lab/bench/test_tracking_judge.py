"""People in the physics world, tracked by scans; and the judge of that."""

from dataclasses import dataclass

import numpy as np
import pytest

from omniman_ros.lab.bench.tracking_judge import TrackingJudge, visible_beams

DIRECTIONS = np.linspace(-0.5, 0.5, 201)
ORIGIN = np.zeros(2)


@dataclass(frozen=True)
class Thing:
    number: int
    center: tuple[float, float]
    velocity: tuple[float, float] = (0.0, 0.0)
    silence: float = 0.0


def sighting(*discs, radius=0.25):
    """What a scanner in the origin truly sees of discs."""
    ranges = np.full(len(DIRECTIONS), 9.0)
    for x, y in discs:
        along = x * np.cos(DIRECTIONS) + y * np.sin(DIRECTIONS)
        aside = x * np.sin(DIRECTIONS) - y * np.cos(DIRECTIONS)
        chord = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
        ranges = np.where(np.abs(aside) < radius, np.minimum(ranges, along - chord), ranges)
    return ORIGIN, DIRECTIONS, ranges


def test_a_person_behind_another_one_is_not_seen():
    places = np.array([[2.0, 0.0], [3.0, 0.0], [3.0, 0.8]])
    front, behind, beside = visible_beams(sighting(*places), places, 0.25)
    assert front > 40
    assert behind == 0
    assert 20 < beside < 45


def judged(reports, people, seconds=2.0):
    """Judge reports and people, both functions of time."""
    judge = TrackingJudge(statics=10)
    for k in range(round(seconds / 0.05)):
        now = 0.05 * k
        truth = np.array(people(now))
        judge.judge(now, sighting(*truth[:, :2]), truth, 0.25, reports(now))
    judge.finish()
    return judge


def walker(t):
    return [(3.0, -1.0 + t, 0.0, 1.0)]


def test_errors_count_from_half_a_second_on():
    def late(now):
        return [Thing(1, (3.0, -1.0 + now), (0.0, 1.0 if now > 0.45 else 0.0))]

    judge = judged(late, walker)
    assert max(judge.errors) == pytest.approx(0.0, abs=1e-9)
    judge = judged(lambda now: [Thing(1, (3.0, -1.0 + now), (0.3, 0.6))], walker)
    assert judge.errors == pytest.approx([0.5] * len(judge.errors))
    assert judge.walking_errors


def test_who_walks_and_is_not_reported_is_missed():
    assert judged(lambda now: [], walker).missed > 20
    assert judged(lambda now: [Thing(1, (3.0, -0.2 + now))], walker).missed > 20


def test_what_stands_and_is_reported_as_moving_for_long_is_false():
    def post(speed, until, silence=0.0):
        return lambda now: [Thing(7, (2.0, 1.5), (speed, 0.0), silence)] if now < until else []

    assert judged(post(0.3, 2.0), walker).false_movers == {7}
    assert not judged(post(0.3, 0.4), walker).false_movers, "not for long"
    assert not judged(post(0.1, 2.0), walker).false_movers, "too slow to count"
    assert not judged(post(0.3, 2.0, silence=0.1), walker).false_movers, "hidden"


def crossing(now):
    return [(2.0, -0.9 + now, 0.0, 1.0), (3.0, 0.9 - now, 0.0, -1.0)]


@pytest.mark.parametrize(("swaps", "kept"), [(False, 2), (True, 0)])
def test_identities_are_compared_before_and_after_a_crossing(swaps, kept):
    def reports(now):
        numbers = (2, 1) if swaps and now > 0.9 else (1, 2)
        places = crossing(now)
        return [Thing(n, place[:2], place[2:]) for n, place in zip(numbers, places, strict=True)]

    judge = judged(reports, crossing)
    assert (judge.crossings, judge.kept) == (2, kept)
