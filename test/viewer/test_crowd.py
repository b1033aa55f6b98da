"""Properties of the obstacles that a page places."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import CASES, Turned
from omniman_ros.viewer.crowd import FASTEST, LARGEST, MOST, SMALLEST, Crowd

SEEDS = range(20)
NAN = math.nan


def any_way(rng):
    return Turned(tuple(rng.uniform(-5.0, 5.0, 2)), tuple(rng.uniform(-1.0, 1.0, 2)))


def some(rng, now=0.0):
    """A crowd of a few obstacles that go."""
    crowd = Crowd()
    for _ in range(rng.integers(1, 8)):
        crowd.add(any_way(rng), now, tuple(rng.uniform(0.1, 1.0, 2)), rng.uniform(-3.0, 3.0))
    return crowd


def same(first, second):
    return all(
        np.allclose(getattr(first, name), getattr(second, name), atol=1e-9)
        for name in ("numbers", "centers", "semi_axes", "angles")
    )


def test_nobody_is_there_at_first():
    crowd = Crowd()
    rows = crowd.rows(10.0)
    assert len(crowd) == 0 and not crowd.held
    assert rows.centers.shape == rows.velocities.shape == rows.semi_axes.shape == (0, 2)
    assert rows.numbers.shape == rows.angles.shape == (0,)


@pytest.mark.parametrize("seed", SEEDS)
def test_all_go_at_their_velocities(seed):
    rng = np.random.default_rng(seed)
    crowd = some(rng, 10.0)
    before, after = crowd.rows(10.0), crowd.rows(12.5)
    assert after.centers == pytest.approx(before.centers + 2.5 * before.velocities)
    assert np.abs(before.velocities).max() > 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_hold_is_time_that_does_not_count(seed):
    """However often it is held and let go, only the time in between moves anybody."""
    rng = np.random.default_rng(seed)
    held, free = some(np.random.default_rng(seed), 0.0), some(np.random.default_rng(seed), 0.0)
    now = gone = 0.0
    for _ in range(5):
        step, rest = rng.uniform(0.0, 3.0, 2)
        now, gone = now + step, gone + step
        held.hold(now)
        held.hold(now + 0.3 * rest)  # again: nothing happens
        rows = held.rows(now + rest)
        assert same(rows, free.rows(gone)) and not rows.velocities.any()
        now += rest
        held.go(now)
        held.go(now + 0.1)
        assert same(held.rows(now + 0.1), free.rows(gone + 0.1))


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_restart_brings_all_back_to_where_they_were_put(seed, held):
    rng = np.random.default_rng(seed)
    crowd = some(rng, 0.0)
    begin = crowd.rows(0.0)
    if held:
        crowd.hold(3.0)
    crowd.restart(5.0)
    assert crowd.held == held
    assert same(crowd.rows(5.0), begin)
    assert held == same(crowd.rows(6.0), begin), "they go, unless they are held"
    crowd.go(7.0)
    ahead = crowd.rows(8.0).centers - crowd.rows(7.0).centers
    assert ahead == pytest.approx(begin.velocities)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_one_that_is_put_is_there_and_begins_there(seed, held):
    rng = np.random.default_rng(seed)
    crowd = some(rng, 0.0)
    velocities = crowd.rows(0.0).velocities
    if held:
        crowd.hold(1.0)
    crowd.put(0, (3.0, -2.0), 2.0)
    assert crowd.rows(2.0).centers[0] == pytest.approx([3.0, -2.0])
    crowd.go(2.0)
    assert crowd.rows(3.0).centers[0] == pytest.approx([3.0, -2.0] + velocities[0])
    crowd.restart(4.0)
    assert crowd.rows(4.0).centers[0] == pytest.approx([3.0, -2.0])


@pytest.mark.parametrize("seed", SEEDS)
def test_one_that_is_sent_goes_on_from_where_it_is_and_begins_at_its_home(seed):
    crowd = some(np.random.default_rng(seed), 0.0)
    home, there = crowd.rows(0.0).centers[0], crowd.rows(2.0).centers[0]
    crowd.send(0, (0.3, -0.2), 2.0)
    assert crowd.rows(2.0).centers[0] == pytest.approx(there)
    assert crowd.rows(3.0).centers[0] == pytest.approx(there + [0.3, -0.2])
    crowd.restart(5.0)
    assert crowd.rows(6.0).centers[0] == pytest.approx(home + [0.3, -0.2])


def test_one_that_is_sent_while_all_are_held_goes_when_they_go():
    crowd = Crowd()
    crowd.hold(0.0)
    crowd.add(Turned((1.0, 1.0)), 0.0)
    crowd.send(0, (0.5, 0.0), 1.0)
    assert crowd.rows(5.0).centers.tolist() == [[1.0, 1.0]]
    crowd.go(5.0)
    assert crowd.rows(7.0).centers.tolist() == [[2.0, 1.0]]


@pytest.mark.parametrize("held", [False, True])
def test_the_course_of_one_that_is_held_is_how_it_goes_on(held):
    crowd = some(np.random.default_rng(3), 0.0)
    if held:
        crowd.hold(1.0)
    courses = crowd.rows(2.0).courses
    crowd.go(2.0)
    ahead = crowd.rows(3.0).centers - crowd.rows(2.0).centers
    assert ahead == pytest.approx(courses) and np.abs(courses).max() > 0.0


def test_a_shape_is_kept_through_a_restart_and_a_drag():
    crowd = some(np.random.default_rng(0), 0.0)
    crowd.shape(0, (0.7, 0.1), 1.5)
    crowd.put(0, (0.0, 0.0), 1.0)
    crowd.restart(2.0)
    rows = crowd.rows(2.0)
    assert rows.semi_axes[0].tolist() == [0.7, 0.1] and rows.angles[0] == 1.5


def test_numbers_are_never_used_again():
    """Another node would take the new one for the old one, jumped."""
    crowd = Crowd()
    numbers = []
    for k in range(10):
        numbers.append(crowd.add(Turned((float(k), 0.0)), 0.0))
        if k % 2:
            crowd.delete(numbers[-1])
        if k == 6:
            crowd.delete(None)
    assert len(set(numbers)) == 10
    assert crowd.rows(0.0).numbers.tolist() == [8]
    assert 8 in crowd and 9 not in crowd


def test_one_that_turns_does_so_in_the_crowds_own_time():
    crowd = Crowd()
    crowd.hold(0.0)
    crowd.add(CASES["moving"].ways[2], 0.0)
    crowd.go(100.0)
    assert crowd.rows(104.4).velocities[0] == pytest.approx([0.0, -0.15])
    assert crowd.rows(104.6).velocities[0] == pytest.approx([0.0, -0.9])


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.put(0, (NAN, 0.0), 0.0), lambda c: c.put(0, (0.0, 2e6), 0.0),
        lambda c: c.put(9, (0.0, 0.0), 0.0), lambda c: c.send(0, (NAN, 0.0), 0.0),
        lambda c: c.send(0, (0.0, -1.01 * FASTEST), 0.0), lambda c: c.send(9, (0.0, 0.0), 0.0),
        lambda c: c.shape(0, (0.99 * SMALLEST, 1.0), 0.0), lambda c: c.shape(9, (1.0, 1.0), 0.0),
        lambda c: c.shape(0, (1.0, 1.01 * LARGEST), 0.0), lambda c: c.shape(0, (1.0, NAN), 0.0),
        lambda c: c.shape(0, (1.0, 1.0), math.inf), lambda c: c[9],
        lambda c: c.add(Turned((0.0, 0.0), (4.0, 0.0)), 0.0),
        lambda c: c.add(Turned((0.0, 0.0), (0.0, 0.0), 1.0, (NAN, 0.0)), 0.0),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_and_changes_nothing(change):
    crowd = Crowd()
    crowd.add(Turned((1.0, 2.0), (0.1, 0.0)), 0.0)
    with pytest.raises(InputError):
        change(crowd)
    rows = crowd.rows(0.0)
    assert rows.centers.tolist() == [[1.0, 2.0]] and rows.velocities.tolist() == [[0.1, 0.0]]


def test_bounds_themselves_can_be():
    crowd = Crowd()
    crowd.add(Turned((1.0, 2.0)), 0.0)
    crowd.shape(0, (SMALLEST, LARGEST), 0.0)
    crowd.send(0, (FASTEST, -FASTEST), 0.0)
    assert crowd.rows(1.0).centers.tolist() == [[1.0 + FASTEST, 2.0 - FASTEST]]


def test_there_are_no_more_than_so_many():
    crowd = Crowd()
    for _ in range(MOST):
        crowd.add(Turned((0.0, 0.0)), 0.0)
    with pytest.raises(InputError, match=str(MOST)):
        crowd.add(Turned((0.0, 0.0)), 0.0)
    crowd.delete(0)
    assert crowd.add(Turned((0.0, 0.0)), 0.0) == MOST
