"""Contacts of the robot."""

import math

import numpy as np
import pytest

from omniman_ros.simulation.world.scene import Column, Crate, Pallet, Person, Post, Scene, Table
from test.simulation.world.support import NO_FRICTION, STEP, ideal, rollers

POST = Post(name="post", x=1.2, y=0.1, radius=0.1)
UPRIGHT = [0.0, -math.pi / 2, 0.0, 0.0, 0.0, 0.0]


def contact_pairs(bench):
    return {(contact.part, contact.element) for contact in bench.world.contacts}


@pytest.mark.parametrize("make", [ideal, rollers])
def test_driving_into_a_post_is_told_within_10_ms(make):
    """The front of omniman is 0.5 m ahead of base_link."""
    bench = make("omniman", Scene(posts=(POST,)))
    bench.world.arm.place(UPRIGHT)
    bench.drive((0.4, 0.0, 0.0), 0.5)
    reached = told = None
    while told is None:
        assert bench.now < 4.0
        assert not bench.world.contacts
        bench.drive((0.4, 0.0, 0.0), 0.005)
        if reached is None and bench.world.pose[0] + 0.5 >= 1.2 - 0.1:
            reached = bench.now
        if bench.world.contacts:
            told = bench.now
    assert reached is not None
    assert abs(told - reached) <= 0.010
    (contact,) = bench.world.contacts
    assert (contact.part, contact.element, contact.touches) == ("base_link", "post", True)
    np.testing.assert_allclose(contact.position[:2], [1.1, 0.1], atol=0.01)


def test_nothing_is_told_where_nothing_touches():
    bench = rollers("omniman", Scene(posts=(POST,)))
    for _ in range(20):
        bench.drive((-0.4, 0.1, 0.3), 0.05)
        assert bench.world.contacts == ()


def test_a_held_robot_pushes_with_the_force_of_its_motors():
    """Without friction and losses: the sum over the wheels of K N V / (R r)."""
    post = Post(name="post", x=0.55, y=0.0, radius=0.1)
    bench = ideal("ig42", Scene(posts=(post,)), motor__gear_efficiency=1.0, **NO_FRICTION)
    bench.volts([3.0] * 4, 2.0)
    (contact,) = bench.world.contacts
    force = 4 * 0.0325 * 24 * 3.0 / 1.85 / 0.1016
    np.testing.assert_allclose(contact.force[:2], [-force, 0.0], atol=0.03 * force)


def test_the_impulse_on_a_person_is_the_momentum_that_the_person_gets():
    person = Person(name="anna", x=(0.9,), y=(0.0,), mass=60.0)
    bench = ideal("ig42", Scene(persons=(person,)), world__person_force=0.0)
    while not bench.world.contacts:
        assert bench.now < 3.0
        bench.drive((0.5, 0.0, 0.0), 0.005)
    while bench.world.contacts[0].touches:
        bench.drives.advance(bench.now + STEP)
        bench.ticks += 1
    (contact,) = bench.world.contacts
    (anna,) = bench.world.obstacles
    assert anna.velocity[0] > 0.05
    np.testing.assert_allclose(-contact.impulse[:2], 60.0 * np.array(anna.velocity), atol=0.1)


def test_a_contact_that_has_ended_is_forgotten():
    bench = ideal("ig42", Scene(posts=(Post(name="post", x=0.75, y=0.0),)))
    bench.drive((0.4, 0.0, 0.0), 1.0)
    assert contact_pairs(bench) == {("base_link", "post")}
    bench.drive((-0.4, 0.0, 0.0), 1.5)
    assert bench.world.contacts == ()


def test_a_table_lets_the_platform_pass_and_not_the_arm():
    table = Table(name="table", x=1.6, y=0.0, length=1.0, width=1.6, height=0.75)
    bench = rollers("omniman", Scene(tables=(table,)))
    bench.world.arm.place(UPRIGHT)
    bench.drive((0.5, 0.0, 0.0), 3.5)
    pairs = contact_pairs(bench)
    assert pairs
    assert all(thing == "table" and part != "base_link" for part, thing in pairs)
    assert bench.world.pose[0] < 1.2

    bare = rollers("omniman", Scene(tables=(table,)), arm__mass=0.0)
    bare.drive((0.5, 0.0, 0.0), 3.5)
    assert bare.world.contacts == ()
    assert bare.world.pose[0] > 1.5


def test_a_low_pallet_meets_a_wheel_or_what_is_between():
    pallet = Pallet(name="pallet", x=1.4, y=0.0, yaw=math.pi / 2, height=0.144)
    bench = rollers("omniman", Scene(pallets=(pallet,)))
    bench.drive((0.3, 0.0, 0.0), 3.0)
    assert {thing for _, thing in contact_pairs(bench)} == {"pallet"}
    assert all(contact.force[0] < 0.0 for contact in bench.world.contacts)
    assert bench.world.pose[0] < 0.8


def test_a_crate_is_pushed_along():
    crate = Crate(name="crate", x=1.0, y=0.0, mass=5.0)
    bench = ideal("omniman", Scene(crates=(crate,)))
    bench.drive((0.4, 0.0, 0.0), 2.5)
    (there,) = bench.world.obstacles
    assert there.pose[0] == pytest.approx(bench.world.pose[0] + 0.5 + 0.3, abs=0.03)
    assert contact_pairs(bench) == {("base_link", "crate")}


def test_an_arm_on_the_floor_is_told():
    bench = ideal("omniman")
    bench.world.arm.command([0.0, 0.75, 0.0, 0.0, 0.0, 0.0])
    bench.wait(2.0)
    assert {thing for _, thing in contact_pairs(bench)} == {"floor"}


def first_contact(bench, twist):
    while not bench.world.contacts:
        assert bench.now < 5.0
        bench.drive(twist, 0.005)
    (contact,) = bench.world.contacts
    return contact


def test_a_contact_tells_who_moved_into_whom():
    """anna walks into the standing robot; the driving robot drives into ben, who stands."""
    anna = Person(name="anna", x=(1.2, -2.0), y=(0.0, 0.0), speed=1.0)
    standing = first_contact(ideal("omniman", Scene(persons=(anna,)), arm__mass=0.0), (0, 0, 0))
    assert 1.0 < standing.element_speed < 1.2
    assert standing.part_speed < 0.01
    ben = Person(name="ben", x=(1.2,), y=(0.0,))
    driving = first_contact(ideal("omniman", Scene(persons=(ben,)), arm__mass=0.0), (0.4, 0, 0))
    assert driving.part_speed == pytest.approx(0.4, abs=0.02)
    assert driving.element_speed < 0.01


def test_the_speed_of_a_part_is_that_of_the_point_that_touches():
    """The robot turns on the spot; its front, 0.5 m ahead, moves by 0.5 m times the rate."""
    post = Post(name="post", x=0.25, y=0.62, radius=0.1, height=1.0)
    contact = first_contact(ideal("omniman", Scene(posts=(post,)), arm__mass=0.0), (0, 0, 0.5))
    reach = np.hypot(*contact.position[:2])
    assert contact.part_speed == pytest.approx(0.5 * reach, rel=0.05)


def test_a_column_is_touched_where_its_ellipse_is_and_can_be_placed_elsewhere():
    """The front of omniman is 0.5 m ahead of base_link, its sides are 0.35 m beside it."""
    shape = {"yaw": 0.5 * math.pi, "length": 1.0, "width": 0.4, "height": 0.35}
    column = Column(name="column", x=0.75, y=0.0, **shape)
    bench = ideal("omniman", Scene(columns=(column,)))
    body = bench.world.engine.body("column")
    bench.wait(STEP)
    assert not bench.world.contacts
    for place, touches in (((0.69, 0.0), True), ((0.0, 0.86), False), ((0.0, 0.84), True)):
        bench.world.engine.place(body, *place)
        bench.wait(2 * STEP)
        touched = {contact.element for contact in bench.world.contacts if contact.touches}
        assert touched == ({"column"} if touches else set()), place


def test_a_post_is_touched_by_the_slanted_side_of_a_platforms_nose():
    """Boxes around the outline would meet the post before."""
    nose = [(-0.5, -0.35), (0.0, -0.35), (0.5, 0.0), (0.0, 0.35), (-0.5, 0.35)]
    x, y = ([corner[axis] for corner in nose] for axis in (0, 1))
    post = Post(name="post", x=0.95, y=0.12, radius=0.05)
    bench = ideal(
        "omniman", Scene(posts=(post,)), body__outline_x=x, body__outline_y=y, arm__mass=0.0
    )
    while not bench.world.contacts:
        assert bench.now < 4.0
        bench.drive((0.4, 0.0, 0.0), 0.01)
    # The post's centre is 0.05 m from the side, which leads from (0, 0.35) to (0.5, 0).
    ahead = (0.05 * math.hypot(0.35, 0.5) + 0.23 * 0.5) / 0.35
    assert bench.world.pose[0] == pytest.approx(0.95 - ahead, abs=0.01)
