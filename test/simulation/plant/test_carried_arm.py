"""The arm's mass on the plant."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.simulation.plant.carried_arm import carried_arm
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.plant import Plant
from test import robots


@pytest.mark.parametrize("seed", range(5))
def test_the_plants_arm_is_that_of_the_controller(seed):
    """Joined from the tool inwards, and composed from the base outwards."""
    rng = np.random.default_rng(seed)
    known, posture = robots.robot().arm, rng.uniform(-math.pi, math.pi, 6)
    tool = tuple(rng.uniform(-0.2, 0.2, 3).tolist())
    arm = replace(known, mass=float(rng.uniform(5.0, 30.0)), tool_centre=tool)
    mount = Mount(*rng.uniform(-1.0, 1.0, 4).tolist())
    ours = ArmMass(arm, mount).at(posture)
    true = carried_arm(arm, mount, posture.tolist())
    for name in ("mass", "com_x", "com_y", "com_z", "inertia"):
        assert getattr(ours, name) == pytest.approx(getattr(true, name), abs=1e-12), name
    assert true.tool_centre == tool


def test_a_mass_that_moves_keeps_the_motion_of_the_platform_and_the_energy_balance():
    robot = robots.robot()
    simulation = build(SimulationParameters, robots.values())
    plant = Plant(robot, simulation)
    plant.set_twist((0.4, 0.2, 0.5))
    plant.set_wheel_speeds(robots.kinematics().J @ [0.4, 0.2, 0.5])
    for k in range(50):
        posture = [0.03 * k, -0.5, 0.5, 0.0, 0.3, 0.0]
        before = plant.twist
        plant.configure(replace(robot, arm=carried_arm(robot.arm, Mount(), posture)), simulation)
        np.testing.assert_allclose(plant.twist, before, atol=1e-12)
        for _ in range(5):
            plant.step([0.0] * 4)
    energy = plant.energy
    assert abs(energy.residual) < 1e-9 * max(energy.turnover, 1.0)
