"""With stiffening contact the plant converges to the model of MPC 2021 (1)-(24)."""

import numpy as np
import pytest

from omniman_ros.simulation.plant.plant import Plant
from test.simulation.plant.support import parameters, robot

MASS, INERTIA, WHEEL = 25.0, 1.6, 0.012
RADIUS, HALF_LENGTH, HALF_WIDTH = 0.1016, 0.25, 0.22
RESISTANCE, CONSTANT, GEAR, ETA = 1.85, 0.0325, 24.0, 0.66
VISCOUS, COULOMB = 0.004, 0.25
LEVER = HALF_LENGTH + HALF_WIDTH
R = np.array([[1, -1, -LEVER], [1, 1, LEVER], [1, 1, -LEVER], [1, -1, LEVER]]) / RADIUS  # (1)
VOLTS = np.array([17.0, 14.0, 20.0, 15.0])
SECONDS = 0.5


def rotation(psi):
    c, s = np.cos(psi), np.sin(psi)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def constrained(state):
    """Return the rate of (x, y, psi, x', y', psi'): MPC 2021 (13)-(18), (21)-(24), L = 0."""
    psi, velocity = state[2], state[3:]
    turned = rotation(psi)
    c, s = np.cos(psi), np.sin(psi)
    turned_rate = velocity[2] * np.array([[-s, -c, 0], [c, -s, 0], [0, 0, 0]])
    wheels = R @ turned.T @ velocity
    current = (VOLTS - CONSTANT * GEAR * wheels) / RESISTANCE  # (21)
    assert (current > 0).all()
    assert (wheels > 0).all()
    friction = VISCOUS * wheels + COULOMB * np.sign(wheels)  # (24)
    torque = ETA * GEAR * CONSTANT * current - friction  # (22)
    wheel_mass = WHEEL * np.eye(4)
    h = np.diag([MASS, MASS, INERTIA]) + turned @ R.T @ wheel_mass @ R @ turned.T  # (14)
    k = turned @ R.T @ wheel_mass @ R @ turned_rate.T  # (15)
    return np.concatenate([velocity, np.linalg.solve(h, turned @ R.T @ torque - k @ velocity)])


def reference(start):
    """Integrate with the fourth-order Runge-Kutta method."""
    state, steps = start.copy(), 1000
    step = SECONDS / steps
    for _ in range(steps):
        k1 = constrained(state)
        k2 = constrained(state + step / 2 * k1)
        k3 = constrained(state + step / 2 * k2)
        k4 = constrained(state + step * k3)
        state += step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


@pytest.fixture(scope="module")
def errors():
    """Return the errors in pose (m, rad) and velocity for successively halved slip velocities."""
    start = np.concatenate([[0.2, -0.1, 0.3], rotation(0.3) @ [0.5, 0.05, 0.4]])
    expected = reference(start)
    machine = robot(
        "ig42",
        motor__inductance=0.0,
        friction__roller=[0.0],
        friction__mu=5.0,
        wheels__x=[HALF_LENGTH, HALF_LENGTH, -HALF_LENGTH, -HALF_LENGTH],
    )
    found = {}
    for slip_velocity in (0.16, 0.08, 0.04, 0.02, 0.01):
        settings = parameters(plant__slip_velocity=slip_velocity, plant__substep=2e-4)
        plant = Plant(machine, settings)
        plant.set_pose(start[:3])
        twist = rotation(start[2]).T @ start[3:]
        plant.set_twist(twist)
        plant.set_wheel_speeds(R @ twist)
        for _ in range(round(SECONDS / 2e-4)):
            plant.step(VOLTS.tolist())
        pose = np.abs(plant.pose - expected[:3]).max()
        velocity = np.abs(rotation(plant.pose[2]) @ plant.twist - expected[3:]).max()
        found[slip_velocity] = (pose, velocity)
    return found


def test_reference_moves_and_turns():
    start = np.concatenate([[0.2, -0.1, 0.3], rotation(0.3) @ [0.5, 0.05, 0.4]])
    end = reference(start)
    assert np.linalg.norm(end[:2] - start[:2]) > 0.3
    assert abs(end[2] - start[2]) > 0.1


@pytest.mark.parametrize("what", [0, 1], ids=["pose", "velocity"])
def test_error_is_proportional_to_the_slip_velocity(errors, what):
    sizes = np.array(list(errors))
    values = np.array([error[what] for error in errors.values()])
    order = np.polyfit(np.log(sizes), np.log(values), 1)[0]
    assert order > 0.95
    assert (values[:-1] / values[1:] > 1.8).all()
    assert values[-1] < 2e-3
