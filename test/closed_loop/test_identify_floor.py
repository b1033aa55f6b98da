"""Identification on the floor, on plants that differ from the controller's configuration."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.platform import PlatformController
from omniman_ros.core.arbiter import Source
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.identification.floor.excitation import choose_excitation, random_excitation
from omniman_ros.identification.floor.feed_forward import feed_forward_residual
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.floor_fit import identify_floor
from omniman_ros.lab.studies.closed_loop import ClosedLoop
from omniman_ros.simulation.plant.contact import centre_of_mass, roller_directions, wheel_loads
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from test import robots

OFF = 0.2
REACH = 0.35
NOISE = 0.1
GRAVITY = 9.81


def other_plant(name, seed, are_motors_alike):
    """Return parameters of a robot off by up to 20 %, and of its simulation.

    The centre of mass is off by up to 20 % of the wheels' distance from the middle, and the motor
    constants by up to 20 %: all by the same, or each by its own.
    """
    rng = np.random.default_rng(seed)
    known = robots.robot(name)

    def factor():
        return float(rng.uniform(1.0 - OFF, 1.0 + OFF))

    true = {
        "body.mass": known.body.mass * factor(),
        "body.inertia": known.body.inertia * factor(),
        "body.com_x": known.body.com_x + (factor() - 1.0) * max(known.wheels.x),
        "body.com_y": known.body.com_y + (factor() - 1.0) * max(known.wheels.y),
        "motor.gear_efficiency": min(known.motor.gear_efficiency * factor(), 0.98),
        "wheels.inertia": [known.wheels.inertia[0] * factor()],
    }
    for kind in ("viscous", "coulomb", "roller"):
        true[f"friction.{kind}"] = [value * factor() for value in getattr(known.friction, kind)]
    constants = [factor() for _ in range(1 if are_motors_alike else known.wheel_count)]
    return true, {"mismatch.torque_constant": constants, "faults.current_noise": NOISE}


class OtherPlantLoop(ClosedLoop):
    """A loop whose plant is not the robot that the controller is configured for."""

    def __init__(self, name, seed, changes=None, are_motors_alike=False):
        true, simulation = other_plant(name, seed, are_motors_alike)
        self.true = robots.robot(name, true)
        built = build(SimulationParameters, {**simulation, **(changes or {})})
        super().__init__(robots.parameters(name), built)
        self.drives = SimulatedDrives(self.true, built, seed)
        self.controller = PlatformController(self.controller.parameters)
        self.step()

    def drive(self, motion):
        """Follow a motion; return what was recorded at the rates of the topics."""
        times = np.arange(0.0, motion.duration + 0.02, 0.02)
        preview = Preview(self.now + 0.1 + times, *motion.track(times))
        assert self.controller.set_preview(Source.PATH, preview, self.now) == ""
        wheels, electrical = [], []
        while self.now < preview.end + 0.3:
            now = self.now
            self.drives.advance(now)
            if self.tick % 4 == 0:  # with wheel_states, as the drives' node reports them
                electrical.append((now, self.drives.electrical()))
            self.step()
            assert np.abs(self.truth[:2]).max() < 1.1 * REACH
            wheels.append((now, self.states.position))
        assert self.controller.latch.released, self.controller.latch.status.reason
        tables = np.array([table for _, table in electrical])
        return FloorDrive(
            np.array([now for now, _ in wheels]),
            np.array([position for _, position in wheels]),
            np.array([now for now, _ in electrical]),
            tables[:, :, 1],
            tables[:, :, 0],
        )


def sideways_drag(robot):
    """Return the force [N] with which the rollers resist sideways motion, by the plant's rules."""
    mass, com, _ = centre_of_mass(robot)
    wheels = robot.wheels
    loads = wheel_loads(wheels.x, wheels.y, com, mass * GRAVITY)
    force = 0.0
    for k, load in enumerate(loads):
        along, across = roller_directions(
            wheels.x[k], wheels.y[k], wheels.heading[k], wheels.roller_angle[k], wheels.radius[k]
        )
        wheel_speed = along.row[1] / along.arm
        force += robot.friction.roller[k] * load * abs(across.row[1] - across.arm * wheel_speed)
    return force


@pytest.mark.parametrize(
    ("seed", "duration", "changes"),
    [
        (2, 16.0, {"plant.substep": 0.005}),
        *(pytest.param(seed, 60.0, {}, marks=pytest.mark.exhaustive) for seed in range(3, 13)),
        pytest.param(13, 60.0, {"plant.roller_velocity": 0.03}, marks=pytest.mark.exhaustive),
    ],
)
def test_masses_and_drag_are_identified_on_a_plant_that_is_off_by_20_percent(
    seed, duration, changes
):
    loop = OtherPlantLoop("omniman", seed, changes)
    parameters = loop.controller.parameters
    motion = choose_excitation(parameters.robot, parameters.limits, REACH, duration)
    found = identify_floor(loop.drive(motion), parameters.robot)
    mass, com, _ = centre_of_mass(loop.true)
    values = {name: estimate.value for name, estimate in found.estimates.items()}
    assert values["mass"] == pytest.approx(mass, rel=0.03)
    assert np.hypot(values["com_x"] - com[0], values["com_y"] - com[1]) < 0.02
    assert values["drag sideways"] == pytest.approx(sideways_drag(loop.true), rel=0.1)
    efficiency = loop.true.motor.gear_efficiency
    assert values["gear_efficiency"] == pytest.approx(efficiency, rel=0.05)
    assert ("drag.front_left", "drag.front_right") in found.inseparable
    assert not found.estimates["drag.front_left"].is_determined
    assert found.estimates["drag sideways"].is_determined
    assert found.estimates["mass"].half_width > 0.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [3, 5, 7, 9, 11])
def test_the_feed_forward_gets_as_good_as_with_the_true_parameters_on_another_drive(seed):
    """What then remains are noise, ripple and smoothed friction, which no parameter removes."""
    loop = OtherPlantLoop("omniman", seed, are_motors_alike=True)
    parameters = loop.controller.parameters
    robot, limits = parameters.robot, parameters.limits
    found = identify_floor(loop.drive(choose_excitation(robot, limits, REACH, 60.0)), robot)
    other = loop.drive(random_excitation(robot, limits, REACH, 20.0, 1000))
    constant = loop.drives.parameters.mismatch.torque_constant[0]
    motor = loop.true.motor
    motor = replace(motor, torque_constant=constant * motor.torque_constant)
    before = feed_forward_residual(other, robot)
    after = feed_forward_residual(other, found.robot)
    ideal = feed_forward_residual(other, replace(loop.true, motor=motor))
    assert after.motion < 1.05 * ideal.motion
    assert after.motion < 0.75 * before.motion
    loop.controller.configure(replace(parameters, robot=found.robot))
    again = loop.drive(random_excitation(found.robot, limits, REACH, 20.0, 1000))
    assert feed_forward_residual(again, found.robot).motion < 0.75 * before.motion
