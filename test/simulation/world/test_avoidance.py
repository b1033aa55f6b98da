"""Reciprocal avoidance, without an engine: persons who have the velocities that they choose."""

import math

import numpy as np
import pytest

from omniman_ros.simulation.world.avoidance import (
    DIRECTIONS,
    AvoidedNeighbours,
    half_planes,
    outline,
)
from omniman_ros.simulation.world.velocity_program import nearest_velocity
from test.tiers import exhaustive

PERIOD = 0.05
RADIUS, CLEARANCE = 0.25, 0.1


def surroundings(outlines, velocities=None, wishes=None, horizon=2.5, fraction=1.0, fixed=0):
    count = len(outlines)
    velocities = np.zeros((count, 2)) if velocities is None else np.array(velocities)
    return AvoidedNeighbours(
        outlines=np.array(outlines).reshape(count, len(DIRECTIONS)),
        velocities=velocities,
        wishes=velocities if wishes is None else wishes,
        reaches=np.full(count, RADIUS + CLEARANCE),
        horizons=np.full(count, horizon),
        fractions=np.broadcast_to(fraction, count).astype(float),
        fixed=fixed,
    )


class Plaza:
    """Persons on a plane, of whom each wants to go to a goal at 1 m/s."""

    def __init__(self, starts, goals, things=()):
        self.places, self.goals = np.array(starts, float), np.array(goals, float)
        self.rates = np.zeros_like(self.places)
        self.things = [outline(np.array(points, float), radius) for points, radius in things]
        self.least = math.inf

    def step(self):
        discs = [outline(place[None], RADIUS) for place in self.places]
        chosen = np.zeros_like(self.rates)
        ways = self.goals - self.places
        wishes = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 0.2)
        rest = np.zeros((len(self.things), 2))
        for k, place in enumerate(self.places):
            others = np.arange(len(discs)) != k
            around = surroundings(
                [
                    *self.things,
                    *(disc for disc, is_other in zip(discs, others, strict=True) if is_other),
                ],
                np.concatenate([rest, self.rates[others]]),
                np.concatenate([rest, wishes[others]]),
                fraction=[1.0] * len(self.things) + [0.5] * (len(discs) - 1),
                fixed=len(self.things),
            )
            planes = half_planes(place, self.rates[k], wishes[k], around)
            hard, soft = planes[: around.fixed], planes[around.fixed :]
            chosen[k] = nearest_velocity(tuple(wishes[k].tolist()), 1.2, hard, soft)
        self.rates = chosen
        self.places = self.places + PERIOD * chosen
        gaps = np.linalg.norm(self.places[:, None] - self.places[None], axis=2)
        np.fill_diagonal(gaps, math.inf)
        self.least = min(self.least, float(gaps.min()) - 2 * RADIUS)

    def run(self, seconds):
        """Return the time at which all have arrived."""
        for k in range(round(seconds / PERIOD)):
            self.step()
            if np.linalg.norm(self.places - self.goals, axis=1).max() < 0.3:
                return k * PERIOD
        return math.inf


def violation(velocity, planes):
    return max(least - nx * velocity[0] - ny * velocity[1] for nx, ny, least in planes)


# the program


def brute_force(wanted, limit, planes):
    """Return the permitted velocity next to `wanted` on a fine grid; None if there is none."""
    grid = np.linspace(-limit, limit, 401)
    x, y = np.meshgrid(grid, grid)
    allowed = np.hypot(x, y) <= limit
    for nx, ny, least in planes:
        allowed &= nx * x + ny * y >= least
    distance = np.where(allowed, np.hypot(x - wanted[0], y - wanted[1]), math.inf)
    best = np.unravel_index(distance.argmin(), distance.shape)
    return (x[best], y[best]) if allowed.any() else None


def random_planes(random, count):
    angles, offsets = random.uniform(0, math.tau, count), random.uniform(-1.0, 0.4, count)
    return [
        (math.cos(a), math.sin(a), c)
        for a, c in zip(angles.tolist(), offsets.tolist(), strict=True)
    ]


@pytest.mark.parametrize("seed", range(30))
def test_the_velocity_is_the_permitted_one_next_to_the_wanted(seed):
    random = np.random.default_rng(seed)
    planes = random_planes(random, 6)
    wanted = tuple(random.uniform(-1.5, 1.5, 2).tolist())
    expected = brute_force(wanted, 1.2, planes)
    found = nearest_velocity(wanted, 1.2, planes[:3], planes[3:])
    assert math.hypot(*found) <= 1.2 + 1e-9
    if expected is not None:
        assert violation(found, planes) <= 1e-6
        assert math.dist(found, wanted) <= math.dist(expected, wanted) + 1e-9
        assert math.dist(found, wanted) >= math.dist(expected, wanted) - 0.02


@pytest.mark.parametrize("seed", range(20))
def test_where_nothing_is_permitted_the_worst_is_as_good_as_it_can_be(seed):
    """Against a fine grid: hard half-planes hold, and the worst of the others is least."""
    random = np.random.default_rng(seed)
    hard = [(0.0, 1.0, -0.3)]
    soft = [(1.0, 0.0, 0.5), (-1.0, 0.0, 0.4), *random_planes(random, 3)]
    found = nearest_velocity((1.0, 0.0), 1.2, hard, soft)
    assert violation(found, hard) <= 1e-6
    grid = np.linspace(-1.2, 1.2, 241)
    x, y = np.meshgrid(grid, grid)
    worst = np.max([least - nx * x - ny * y for nx, ny, least in soft], axis=0)
    worst[(np.hypot(x, y) > 1.2) | (y < -0.3)] = math.inf
    assert violation(found, soft) <= worst.min() + 1e-6


def test_hard_half_planes_that_contradict_each_other_are_soft():
    found = nearest_velocity((1.0, 0.0), 1.2, [(1.0, 0.0, 0.4), (-1.0, 0.0, 0.2)], [])
    assert found[0] == pytest.approx(0.1, abs=1e-6)


# the half-planes


def test_the_half_plane_of_a_disc_at_rest_is_tangent_to_its_velocity_obstacle():
    """Walking at the disc's left half: out of the cone, whose legs have the angle asin(R/d)."""
    other = outline(np.array([(2.0, 0.0)]), RADIUS)
    wish = np.array([1.0, 0.25])
    ((nx, ny, least),) = half_planes(np.zeros(2), wish, wish, surroundings([other]))
    reach = 2 * RADIUS + CLEARANCE
    leg = math.asin(reach / 2.0)
    assert math.atan2(ny, nx) == pytest.approx(leg + math.pi / 2, abs=math.tau / 72)
    assert least <= 1e-9
    on_leg = nearest_velocity((1.0, 0.25), 1.2, [(nx, ny, least)], [])
    assert leg - 1e-9 <= math.atan2(on_leg[1], on_leg[0]) < leg + 0.1


def test_two_who_avoid_each_other_move_apart_by_opposite_changes():
    """The normals are opposite, and each takes half of the change."""
    places = np.array([(0.0, 0.0), (2.0, 0.1)])
    rates = np.array([(1.0, 0.0), (-0.8, 0.1)])
    planes = []
    for k in (0, 1):
        other = outline(places[1 - k : 2 - k], RADIUS)
        around = surroundings([other], rates[1 - k : 2 - k], fraction=0.5)
        planes += half_planes(places[k], rates[k], rates[k], around)
    (ax, ay, a), (bx, by, b) = planes
    assert (ax, ay) == pytest.approx((-bx, -by))
    changes = [a - rates[0] @ (ax, ay), b - rates[1] @ (bx, by)]
    assert changes[0] == pytest.approx(changes[1])
    assert changes[0] > 0.1


def test_a_thing_at_rest_permits_to_stand():
    random = np.random.default_rng(1)
    for _ in range(100):
        points = random.uniform(-1, 1, (4, 2)) + (0.0, 2.5)
        wish = random.uniform(-1, 1, 2)
        ((_, _, least),) = half_planes(np.zeros(2), wish, wish, surroundings([outline(points)]))
        assert least <= 1e-12


def test_who_is_too_near_moves_apart():
    near = outline(np.array([(0.5, 0.0)]), RADIUS)
    wish = np.array([1.0, 0.0])
    plane = half_planes(np.zeros(2), wish, wish, surroundings([near]))
    velocity = nearest_velocity((1.0, 0.0), 1.2, [], plane)
    assert velocity[0] == pytest.approx(-0.2, abs=1e-6)


# walks


def test_who_meet_head_on_pass_on_the_right():
    plaza = Plaza([(-3, 0), (3, 0)], [(3, 0), (-3, 0)])
    for _ in range(round(3.0 / PERIOD)):
        plaza.step()
    assert plaza.places[0, 1] < -0.2
    assert plaza.places[1, 1] > 0.2


@pytest.mark.parametrize("count", [3, exhaustive(4), exhaustive(6), 8, exhaustive(10)])
def test_a_circle_that_crosses_in_its_middle_does_not_lock(count):
    angles = math.tau / count * np.arange(count)
    circle = 4.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    plaza = Plaza(circle, -circle)
    assert plaza.run(20.0) < 12.0
    assert plaza.least > 0.9 * CLEARANCE


def scattered(random, count):
    """Return places that are at least 0.8 m apart."""
    places = []
    while len(places) < count:
        place = random.uniform(-4.0, 4.0, 2)
        if all(math.dist(place, other) > 0.8 for other in places):
            places.append(place)
    return places


@pytest.mark.parametrize("seed", [0, 1, *(exhaustive(k) for k in range(2, 20))])
def test_random_crossings_end_without_a_touch(seed):
    random = np.random.default_rng(seed)
    plaza = Plaza(scattered(random, 6), scattered(random, 6))
    assert plaza.run(30.0) < 20.0
    assert plaza.least > 0.9 * CLEARANCE
