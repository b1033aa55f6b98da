"""Persons in the physics world."""

import math

import numpy as np
import pytest

from omniman_ros.simulation.world.scene import REACTIVE, Crate, Person, Post, Scene, Wall
from test.simulation.world.support import ideal
from test.tiers import exhaustive


def walk(bench, seconds, name="anna"):
    """Return positions (k, 2) every 10 ms."""
    places = []
    for _ in range(round(seconds / 0.01)):
        bench.wait(0.01)
        (anna,) = (each for each in bench.world.obstacles if each.name == name)
        places.append(anna.pose[:2])
    return np.array(places)


def test_a_person_walks_from_point_to_point_and_back():
    """4 m at 1 m/s to the last point, and what it takes to start and to turn: less than 1 s."""
    anna = Person(name="anna", x=(2.0, 4.0, 4.0), y=(0.0, 0.0, 2.0), speed=1.0)
    places = walk(ideal("ig42", Scene(persons=(anna,))), 8.5)
    for point, first, last in (
        ((4.0, 0.0), 2.0, 2.7),
        ((4.0, 2.0), 4.0, 5.0),
        ((2.0, 0.0), 6.8, 8.4),
    ):
        near = np.nonzero(np.linalg.norm(places - point, axis=1) < 0.25)[0] / 100
        assert first - 0.3 < near[near > first - 1.0][0] < last
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / 0.01
    assert speeds.max() < 1.3


def test_a_person_who_is_held_up_waits_and_then_goes_on():
    anna = Person(name="anna", x=(2.0, 6.0), y=(0.0, 0.0), speed=1.0)
    wall = Wall(name="wall", x=(4.0, 4.0), y=(-1.0, 1.0))
    bench = ideal("ig42", Scene(persons=(anna,), walls=(wall,)))
    places = walk(bench, 6.0)
    assert places[:, 0].max() < 4.0
    np.testing.assert_allclose(places[-1], places[-100], atol=1e-3)


def test_a_person_pushes_with_no_more_than_the_largest_force():
    """anna walks against the standing robot, whose motors are shorted."""
    anna = Person(name="anna", x=(1.2, -2.0), y=(0.0, 0.0), speed=1.0)
    bench = ideal("omniman", Scene(persons=(anna,)), arm__mass=0.0, world__person_force=50.0)
    walk(bench, 3.0)
    (contact,) = bench.world.contacts
    assert (contact.part, contact.element) == ("base_link", "anna")
    assert np.linalg.norm(contact.force) == pytest.approx(50.0, rel=0.05)


def test_persons_do_not_walk_through_posts():
    anna = Person(name="anna", x=(2.0, 5.0), y=(0.0, 0.0), speed=1.0)
    post = Post(name="post", x=3.5, y=0.0, radius=0.2)
    places = walk(ideal("ig42", Scene(persons=(anna,), posts=(post,))), 4.0)
    assert np.hypot(places[:, 0] - 3.5, places[:, 1]).min() > 0.2 + 0.25 - 0.03


def reactive(name, x, y, **values):
    return Person(name=name, x=x, y=y, behaviour=REACTIVE, **values)


def gap(bench):
    """Return the least gap between two persons [m]."""
    places = np.array([person.pose[:2] for person in bench.world.obstacles])
    distances = np.linalg.norm(places[:, None] - places[None], axis=2)
    return distances[np.triu_indices(len(places), 1)].min() - 0.5


@pytest.mark.parametrize("seed", [5, *(exhaustive(k) for k in range(20) if k != 5)])
def test_reactive_persons_cross_without_a_touch_and_reach_their_points(seed):
    """Five persons on random ways around the standing robot, which they keep clear of, too."""
    random = np.random.default_rng(seed)
    angles = math.tau / 5 * np.arange(5) + random.uniform(0.0, 0.8, 5)
    x, y = 3.0 * np.cos(angles), 3.0 * np.sin(angles)
    turned = random.permutation(5)
    persons = tuple(
        reactive(f"p{k}", (x[k], -x[j]), (y[k], -y[j])) for k, j in enumerate(turned.tolist())
    )
    bench = ideal("ig42", Scene(persons=persons), arm__mass=0.0)
    reached = set()
    while len(reached) < 5:
        bench.wait(0.05)
        assert bench.now < 20.0
        assert bench.world.contacts == ()
        assert gap(bench) > 0.05
        for person, there in zip(persons, bench.world.obstacles, strict=True):
            if math.dist(there.pose[:2], (person.x[1], person.y[1])) < 0.3:
                reached.add(person.name)


def test_reactive_persons_walk_around_a_robot_that_stands_in_the_corridor():
    walls = tuple(Wall(name=f"wall{y}", x=(-4.0, 4.0), y=(y, y)) for y in (-1.5, 1.5))
    persons = (
        reactive("anna", (-2.5, 2.5), (0.0, 0.0)),
        reactive("ben", (2.5, -2.5), (0.0, 0.0)),
    )
    bench = ideal("omniman", Scene(persons=persons, walls=walls), arm__mass=0.0)
    for _ in range(80):
        bench.wait(0.1)
        assert bench.world.contacts == ()
        assert gap(bench) > 0.05
        anna, ben = bench.world.obstacles
        if anna.pose[0] > 2.2 and ben.pose[0] < -2.2:
            return
    pytest.fail("they did not pass")


def test_a_reactive_person_gives_way_to_the_robot_that_comes():
    anna = reactive("anna", (1.5,), (0.0,))
    bench = ideal("omniman", Scene(persons=(anna,)), arm__mass=0.0)
    for _ in range(80):
        bench.drive((0.6, 0.0, 0.0), 0.05)
        assert bench.world.contacts == ()
    (there,) = bench.world.obstacles
    assert bench.world.pose[0] > 2.0
    assert math.dist(there.pose[:2], (1.5, 0.0)) < 2.5


def test_a_reactive_person_who_has_given_way_returns():
    anna = reactive("anna", (1.5,), (0.0,))
    ben = Person(name="ben", x=(4.0, -9.0), y=(0.0, 0.0), speed=1.5)
    scene = Scene(start=(0.0, -5.0, 0.0), persons=(anna, ben))
    places = walk(ideal("ig42", scene, arm__mass=0.0), 5.5)
    assert places[:, 1].min() < -0.5
    np.testing.assert_allclose(places[-1], (1.5, 0.0), atol=0.05)


def test_a_reactive_person_walks_around_a_crate_without_a_push():
    anna = reactive("anna", (3.0, 0.0), (3.0, 3.0))
    crate = Crate(name="crate", x=1.5, y=3.0)
    bench = ideal("ig42", Scene(persons=(anna,), crates=(crate,)))
    places = walk(bench, 4.0)
    assert places[-1, 0] < 0.3
    there = next(each for each in bench.world.obstacles if each.name == "crate")
    np.testing.assert_allclose(there.pose[:2], (1.5, 3.0), atol=1e-4)


def test_a_reactive_person_before_a_wall_waits():
    anna = reactive("anna", (2.0, 6.0), (0.0, 0.0))
    wall = Wall(name="wall", x=(4.0, 4.0), y=(-3.0, 3.0))
    places = walk(ideal("ig42", Scene(persons=(anna,), walls=(wall,))), 5.0)
    assert places[:, 0].max() < 4.0 - 0.05 - 0.25 - 0.1
    np.testing.assert_allclose(places[-1], places[-50], atol=0.02)
