"""Wheels mounted differently from the robot's parameters."""

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.plant.plant import Plant
from test.simulation.plant.support import parameters, robot

MOUNTING = {
    "mismatch__radius": [1.02, 0.98, 1.01, 0.99],
    "mismatch__offset_x": [0.02, -0.01, 0.015, 0.0],
    "mismatch__offset_y": [-0.01, 0.02, 0.0, 0.01],
    "mismatch__heading": [0.03, -0.02, 0.05, 0.01],
    "mismatch__roller_angle": [-0.04, 0.02, 0.0, 0.03],
}


def as_configured(name):
    """Return a robot configured with the geometry that MOUNTING gives a nominal robot."""
    wheels = robot(name).wheels
    return robot(
        name,
        wheels__radius=np.multiply(wheels.radius, MOUNTING["mismatch__radius"]).tolist(),
        wheels__x=np.add(wheels.x, MOUNTING["mismatch__offset_x"]).tolist(),
        wheels__y=np.add(wheels.y, MOUNTING["mismatch__offset_y"]).tolist(),
        wheels__heading=np.add(wheels.heading, MOUNTING["mismatch__heading"]).tolist(),
        wheels__roller_angle=np.add(
            wheels.roller_angle, MOUNTING["mismatch__roller_angle"]
        ).tolist(),
    )


@pytest.mark.parametrize("name", ["omniman", "ig42"])
def test_mismatched_robot_moves_like_one_with_that_configuration(name):
    """Loads, levers and the slippery patch follow the wheels, not the parameters."""
    patch = {
        "plant__patch_x_min": robot(name).wheels.x[0] + 0.01,
        "plant__patch_x_max": 9.0,
        "plant__patch_y_min": -9.0,
        "plant__patch_y_max": 9.0,
        "plant__patch_mu": 0.05,
    }
    one = Plant(robot(name), parameters(**MOUNTING, **patch))
    two = Plant(as_configured(name), parameters(**patch))
    nominal = Plant(robot(name), parameters(**patch))
    rng = np.random.default_rng(1)
    table = rng.uniform(-12, 15, (20, 4))
    for k in range(1000):
        for plant in (one, two, nominal):
            plant.step(table[k // 50].tolist())
    np.testing.assert_allclose(one.pose, two.pose, atol=1e-12)
    np.testing.assert_allclose(one.twist, two.twist, atol=1e-12)
    assert np.abs(one.pose - nominal.pose).max() > 1e-3


def test_wheels_all_steered_left_drive_to_the_left():
    angle = 0.1
    plant = Plant(robot("omniman", arm__mass=0.0), parameters(mismatch__heading=[angle]))
    for _ in range(3000):
        plant.step([10.0] * 4)
    x, y, heading = plant.pose
    assert x > 0.5
    assert np.arctan2(y, x) == pytest.approx(angle, abs=0.003)
    assert heading == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["offset_x", "offset_y", "heading", "roller_angle", "radius"])
def test_wrong_number_of_values_is_rejected_naming_the_parameter(name):
    with pytest.raises(ParameterError, match=rf"mismatch\.{name}.*one value or 4, one per wheel"):
        Plant(
            robot(),
            parameters(**{f"mismatch__{name}": [0.9, 1.0] if name == "radius" else [0.1, 0.1]}),
        )


@pytest.mark.parametrize(
    ("name", "value"),
    [("offset_x", 0.3), ("offset_y", -0.3), ("heading", 1.0), ("roller_angle", -1)],
)
def test_implausible_values_are_rejected(name, value):
    with pytest.raises(ParameterError, match=name):
        parameters(**{f"mismatch__{name}": [value]})


def test_mounting_that_does_not_support_the_centre_of_mass_is_rejected():
    plant = Plant(robot("omniman", body__com_x=0.3, arm__mass=0.0), parameters())
    tipping = parameters(mismatch__offset_x=[-0.2])
    with pytest.raises(ParameterError, match="must be above the wheels"):
        plant.configure(robot("omniman", body__com_x=0.3, arm__mass=0.0), tipping)
