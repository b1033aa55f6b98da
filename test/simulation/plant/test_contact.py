import math

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.plant.contact import (
    ContactFriction,
    centre_of_mass,
    roller_directions,
    smooth_friction,
    wheel_loads,
)
from test.simulation.plant.support import robot


def surface_velocity(x, y, heading, radius, twist, wheel_speed):
    """Return the velocity of the wheel's lowest point over the floor by a small displacement."""
    step = 1e-6

    def hub(time):
        angle = twist[2] * time
        c, s = math.cos(angle), math.sin(angle)
        return np.array([twist[0] * time + c * x - s * y, twist[1] * time + s * x + c * y])

    centre = (hub(step) - hub(-step)) / (2 * step)
    rolling = np.array([math.cos(heading), math.sin(heading)])
    # the spoke that points down turns backwards under the hub
    return centre - rolling * radius * math.sin(wheel_speed * step) / step


def test_contact_directions_give_the_slip_and_rolling_of_the_surface():
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, y, heading, gamma = rng.uniform(-1, 1, 4)
        radius, twist, speed = rng.uniform(0.05, 0.2), rng.uniform(-1, 1, 3), rng.uniform(-9, 9)
        surface = surface_velocity(x, y, heading, radius, twist, speed)
        along = np.array([math.cos(heading + gamma), math.sin(heading + gamma)])
        across = np.array([-along[1], along[0]])
        for direction, unit in zip(
            roller_directions(x, y, heading, gamma, radius), (along, across), strict=True
        ):
            got = np.dot(direction.row, twist) - direction.arm * speed
            assert got == pytest.approx(unit @ surface, abs=1e-8)
            assert len(direction.row) == 3


def test_omni_wheel_rolls_ahead_and_its_roller_sideways():
    along, across = roller_directions(0.3, 0.2, 0.0, 0.0, 0.1)
    assert along.row[:2] == pytest.approx((1.0, 0.0))
    assert along.arm == pytest.approx(0.1)
    assert across.row[:2] == pytest.approx((0.0, 1.0))
    assert across.arm == pytest.approx(0.0)


def test_loads_of_a_symmetric_platform_are_equal():
    wheels = robot("ig42").wheels
    loads = wheel_loads(wheels.x, wheels.y, (0.0, 0.0), 100.0)
    assert loads.shape == (4,)
    np.testing.assert_allclose(loads, 25.0)


@pytest.mark.parametrize("name", ["omni3", "mecanum6", "mecanum8", "skewed4"])
def test_loads_balance_weight_and_moments(name):
    wheels = robot(name).wheels
    com = (0.03, -0.02)
    loads = wheel_loads(wheels.x, wheels.y, com, 250.0)
    assert loads.min() >= 0
    assert loads.sum() == pytest.approx(250.0)
    assert loads @ np.array(wheels.x) == pytest.approx(250.0 * com[0])
    assert loads @ np.array(wheels.y) == pytest.approx(250.0 * com[1])


def test_loads_are_never_negative():
    # springs would let the far wheels pull
    x, y = (0.3, 0.3, 0.0, 0.0, -0.3, -0.3), (0.2, -0.2) * 3
    loads = wheel_loads(x, y, (0.25, 0.0), 100.0)
    np.testing.assert_allclose(loads[4:], 0.0)
    assert loads.sum() == pytest.approx(100.0)
    assert loads @ np.array(x) == pytest.approx(25.0)


@pytest.mark.parametrize("com", [(0.5, 0.0), (0.0, -0.3), (-0.26, 0.0)])
def test_tipping_robot_is_rejected(com):
    wheels = robot("ig42").wheels
    with pytest.raises(ParameterError, match="must be above the wheels"):
        wheel_loads(wheels.x, wheels.y, com, 100.0)


def test_centre_of_mass_combines_platform_and_arm():
    mass, com, inertia = centre_of_mass(robot("omniman"))
    assert mass == pytest.approx(160.4)
    assert com == pytest.approx((20.4 * 0.2 / 160.4, 0.0))
    # reduced mass times the distance squared
    assert inertia == pytest.approx(15.0 + 1.2 + 140 * 20.4 / 160.4 * 0.2**2)


def test_smooth_friction_is_odd_bounded_and_has_the_given_slope():
    for speed in (-3.0, -0.01, 0.0, 0.002, 0.5):
        force, slope = smooth_friction(speed, 40.0, 0.01)
        assert abs(force) < 40.0
        assert force * speed <= 0
        step = 1e-7
        ahead = smooth_friction(speed + step, 40.0, 0.01)[0]
        back = smooth_friction(speed - step, 40.0, 0.01)[0]
        assert slope == pytest.approx(-(ahead - back) / (2 * step), rel=1e-5, abs=1e-6)
    assert smooth_friction(1.0, 40.0, 1e-6)[0] == pytest.approx(-40.0)
    assert smooth_friction(0.01, 40.0, 0.01)[0] == pytest.approx(-40.0 / math.sqrt(2))


def test_contact_never_supplies_energy_when_its_speed_reverses():
    contact = ContactFriction()
    contact.set_floor(100.0, 0.01)
    contact.resolve(0.5, 1e-6)  # an arbitrary speed before
    contact.begin(0.5)
    contact.linearise()
    for _ in range(20):
        settled = contact.resolve(-0.1, 1e-6)
        contact.linearise()
        contact.offset, contact.slope = contact._law, 0.0
        if settled:
            break
    assert settled
    assert contact.force * (0.5 - 0.1) < 0
