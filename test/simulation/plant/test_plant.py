import math

import numpy as np
import pytest

from omniman_ros.simulation.plant.plant import Plant
from test.simulation.plant.support import parameters, robot

FRICTIONLESS = {
    "friction__viscous": [0.0],
    "friction__coulomb": [0.0],
    "friction__roller": [0.0],
}


def run(plant, voltages, seconds):
    for _ in range(round(seconds / 0.001)):
        plant.step(voltages)


def speeds(plant):
    return np.array([wheel.speed for wheel in plant.wheels])


def test_centre_of_mass_moves_straight_in_free_flight_and_base_link_circles():
    plant = Plant(robot("omniman", **FRICTIONLESS), parameters(plant__gravity=0.0))
    com = np.array([20.4 * 0.2 / 160.4, 0.0])
    heading, twist = 0.4, np.array([0.5, -0.3, 1.5])
    plant.set_pose([1.0, 2.0, heading])
    plant.set_twist(twist)

    def rotated(angle, vector):
        c, s = math.cos(angle), math.sin(angle)
        return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])

    start = np.array([1.0, 2.0]) + rotated(heading, com)
    velocity = rotated(heading, twist[:2] + twist[2] * np.array([-com[1], com[0]]))
    run(plant, [0.0] * 4, 1.0)
    x, y, angle = plant.pose
    assert angle == pytest.approx(heading + 1.5)
    np.testing.assert_allclose([x, y] + rotated(angle, com), start + velocity, atol=1e-12)
    speed = rotated(angle, plant.twist[:2] + 1.5 * np.array([-com[1], com[0]]))
    np.testing.assert_allclose(speed, velocity, atol=1e-12)


@pytest.mark.parametrize(
    ("signs", "direction"),
    [((1, 1, 1, 1), (1, 0)), ((-1, 1, 1, -1), (0, 1))],
)
def test_spinning_wheels_accelerate_the_robot_along_a_parabola(signs, direction):
    """All wheels slip strongly: each gives mu N along its roller, so a = mu g cos 45."""
    mu = 0.3
    changes = {**FRICTIONLESS, "friction__mu": mu, "wheels__inertia": [50.0]}
    plant = Plant(robot("ig42", **changes), parameters(plant__slip_velocity=1e-4))
    plant.set_wheel_speeds(100.0 * np.array(signs))
    for wheel in plant.wheels:
        wheel.open_circuit = True
    run(plant, [0.0] * 4, 0.5)
    acceleration = mu * 9.81 * math.cos(math.pi / 4)
    along = acceleration * np.array(direction)
    np.testing.assert_allclose(plant.twist[:2], 0.5 * along, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(plant.pose[:2], 0.125 * along, rtol=1e-4, atol=1e-9)


def test_lifted_wheel_follows_the_exponential_of_its_motor():
    viscous = 0.01
    machine = robot(
        "ig42",
        friction__coulomb=[0.0],
        friction__viscous=[viscous],
        motor__inductance=0.0,
        motor__gear_efficiency=1.0,
    )
    plant = Plant(machine, parameters(plant__lifted=True))
    run(plant, [6.0, -6.0, 3.0, 0.0], 0.05)
    back_emf, resistance, inertia = 0.0325 * 24, 1.85, 0.012
    damping = back_emf**2 / resistance + viscous
    expected = back_emf / resistance * np.array([6, -6, 3, 0]) / damping
    expected *= 1 - math.exp(-0.05 * damping / inertia)
    np.testing.assert_allclose(speeds(plant), expected, rtol=1e-4)
    np.testing.assert_array_equal(plant.twist, 0.0)
    np.testing.assert_array_equal(plant.pose, 0.0)


def test_lifting_in_motion_removes_the_energy_of_the_chassis_only():
    plant = Plant(robot("omniman"), parameters())
    run(plant, [20.0] * 4, 1.0)
    assert plant.twist[0] > 0.3
    plant.configure(robot("omniman"), parameters(plant__lifted=True))
    np.testing.assert_array_equal(plant.twist, 0.0)
    assert speeds(plant).min() > 1.0
    assert plant.energy.external < 0
    assert abs(plant.energy.residual) < 1e-9 * plant.energy.turnover


def test_opposed_wheels_heat_the_floor_and_leave_the_chassis_still():
    """(1, 1, -1, -1): the diagonals work against each other (CCTA 2017 (16))."""
    plant = Plant(robot("ig42"), parameters())
    run(plant, [12.0, 12.0, -12.0, -12.0], 1.0)
    np.testing.assert_allclose(plant.twist, 0.0, atol=1e-9)
    np.testing.assert_allclose(plant.pose, 0.0, atol=1e-9)
    assert speeds(plant) @ [1, 1, -1, -1] > 4.0
    assert plant.energy.slip > 10.0


@pytest.mark.parametrize(
    ("pattern", "axis"),
    [((1, 1, 1, 1), 0), ((-1, 1, 1, -1), 1), ((-1, 1, -1, 1), 2)],
)
def test_wheel_patterns_move_the_robot_along_their_axis(pattern, axis):
    plant = Plant(robot("ig42"), parameters())
    run(plant, 6.0 * np.array(pattern), 0.5)
    twist = plant.twist
    assert twist[axis] > 0.1
    np.testing.assert_allclose(np.delete(twist, axis), 0.0, atol=1e-9)


def test_sideways_motion_has_more_drag_than_ahead():
    """Turning rollers cause drag (CCTA 2017 (23)), tested on a pushed, coasting platform."""
    machine = robot("omni3", friction__coulomb=[0.0], friction__viscous=[0.0])
    # an omni platform on three wheels, pushed: rollers turn; Mecanum wheels ahead: they stand
    mecanum = robot(
        "ig42", friction__coulomb=[0.0], friction__viscous=[0.0], friction__roller=[0.02]
    )

    def lost(axis, pattern):
        plant = Plant(mecanum, parameters(faults__dead_motor=mecanum.wheels.names))
        twist = np.zeros(3)
        twist[axis] = 1.0
        plant.set_wheel_speeds(np.array(pattern) / 0.1016)
        plant.set_twist(twist)
        run(plant, [0.0] * 4, 0.5)
        return 1.0 - plant.twist[axis]

    assert lost(0, (1, 1, 1, 1)) == pytest.approx(0.0, abs=1e-6)
    # sideways each roller turns at sqrt(2) times the speed: drag c N against its free direction
    mass = 25.0 + 4 * 0.012 / 0.1016**2
    expected = 0.5 * 0.02 * 25.0 * 9.81 * math.sqrt(2) / mass
    assert lost(1, (-1, 1, 1, -1)) == pytest.approx(expected, rel=0.02)
    plant = Plant(machine, parameters())
    plant.set_twist([0.5, 0.0, 0.0])
    run(plant, [0.0] * 3, 0.2)
    assert plant.energy.roller > 0


def test_wheels_on_the_patch_have_the_friction_of_the_patch():
    patch = {
        "plant__patch_x_min": 0.1,
        "plant__patch_x_max": 1.0,
        "plant__patch_y_min": -1.0,
        "plant__patch_y_max": 0.0,
        "plant__patch_mu": 0.05,
    }
    plant = Plant(robot("ig42"), parameters(**patch))
    plant.step([0.0] * 4)
    load = 25.0 * 9.81 / 4
    grips = [wheel.axis.limit / load for wheel in plant.wheels]
    assert grips == pytest.approx([0.6, 0.05, 0.6, 0.6])
    plant.set_pose([0.55, 0.0, math.pi])  # front right is now behind and left
    plant.step([0.0] * 4)
    grips = [wheel.axis.limit / load for wheel in plant.wheels]
    assert grips == pytest.approx([0.05, 0.6, 0.05, 0.6])
    plant.configure(robot("ig42"), parameters())
    plant.step([0.0] * 4)
    assert [wheel.axis.limit / load for wheel in plant.wheels] == pytest.approx([0.6] * 4)


def test_wheels_spin_on_a_slippery_floor():
    def slip(mu):
        plant = Plant(robot("ig42", friction__mu=mu), parameters())
        run(plant, [12.0] * 4, 0.3)
        return speeds(plant)[0] * 0.1016 - plant.twist[0]

    assert slip(0.05) > 0.5
    assert slip(2.0) < 0.05


def test_body_on_a_circle_moves_as_its_wheels_turn():
    """Without slip the heading turns along with the velocity, also within a step."""
    changes = {**FRICTIONLESS, "friction__mu": 5.0, "wheels__inertia": [100.0]}
    plant = Plant(
        robot("ig42", **changes),
        parameters(plant__slip_velocity=1e-7, faults__dead_motor=robot("ig42").wheels.names),
    )
    speed, turn, lever = 0.5, 1.5, 0.25 + 0.22
    sides = np.array([-1, 1, -1, 1])
    plant.set_wheel_speeds((speed + sides * lever * turn) / 0.1016)
    plant.set_twist([speed, 0.0, turn])
    run(plant, [0.0] * 4, 1.0)
    # forwards, sideways and turning, as four wheels on the corners roll
    patterns = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], sides / lever]) / 4
    np.testing.assert_allclose(plant.twist, patterns @ speeds(plant) * 0.1016, atol=1e-6)
    circle = speed / turn * np.array([math.sin(turn), 1 - math.cos(turn)])
    np.testing.assert_allclose(plant.pose[:2], circle, atol=5e-4)


def test_shorter_substeps_converge_and_a_millisecond_is_short_enough():
    def pose(step):
        plant = Plant(robot("omniman"), parameters(plant__substep=step))
        for _ in range(round(0.4 / step)):
            plant.step([20.0, 14.0, 22.0, 12.0])
        return plant.pose

    exact = pose(5e-5)
    error = {step: np.abs(pose(step) - exact).max() for step in (4e-3, 1e-3, 2e-4)}
    assert error[1e-3] < 3e-4
    assert error[2e-4] < 0.4 * error[1e-3] < 0.4 * error[4e-3]


def test_step_takes_few_iterations_and_always_converges():
    plant = Plant(robot("omniman"), parameters())
    rng = np.random.default_rng(3)
    for k in range(2000):
        if k % 50 == 0:
            voltages = rng.uniform(-48, 48, 4).tolist()
        plant.step(voltages)
    assert plant.unsettled == 0
    assert plant.iterations < 4 * 2000
    calm = Plant(robot("omniman"), parameters())
    for k in range(2000):
        calm.step([0.01 * k] * 4)
    assert calm.iterations < 1.5 * 2000


def test_unequal_radii_turn_a_robot_driven_straight():
    plant = Plant(robot("ig42"), parameters(mismatch__radius=[1.0, 1.05, 1.0, 1.05]))
    run(plant, [8.0] * 4, 1.0)
    assert plant.pose[2] > 0.003
