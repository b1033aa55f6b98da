"""Persons."""

import numpy as np
import pytest

from omniman_ros.simulation.world.scene import Person, Post, Scene, Wall
from test.simulation.world.support import ideal


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


def test_a_person_at_a_single_point_stands():
    anna = Person(name="anna", x=(2.0,), y=(1.0,))
    np.testing.assert_allclose(
        walk(ideal("ig42", Scene(persons=(anna,))), 1.0), [[2.0, 1.0]] * 100, atol=1e-6
    )


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
    assert (contact.part, contact.thing) == ("base_link", "anna")
    assert np.linalg.norm(contact.force) == pytest.approx(50.0, rel=0.05)


def test_persons_do_not_walk_through_posts():
    anna = Person(name="anna", x=(2.0, 5.0), y=(0.0, 0.0), speed=1.0)
    post = Post(name="post", x=3.5, y=0.0, radius=0.2)
    places = walk(ideal("ig42", Scene(persons=(anna,), posts=(post,))), 4.0)
    assert np.hypot(places[:, 0] - 3.5, places[:, 1]).min() > 0.2 + 0.25 - 0.03
