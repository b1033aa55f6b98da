"""Currents of a robot on a prescribed motion, by Newton and Euler; shares no model of the fit."""

import math

import numpy as np

from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.simulation.plant.contact import centre_of_mass, roller_directions, wheel_loads

GRAVITY = 9.81


def prescribed_drive(robot, motion, period=0.005, slope=(0.0, 0.0)):
    """Return the drive of a robot that follows a motion exactly, on a floor with a slope [rad]."""
    mass, com, inertia = centre_of_mass(robot)
    times = np.arange(0.0, motion.duration, period)
    poses, velocities, accelerations = motion.track(times)
    wheels, motor, friction = robot.wheels, robot.motor, robot.friction
    n = robot.wheel_count
    loads = wheel_loads(wheels.x, wheels.y, com, mass * GRAVITY)
    contacts = [
        roller_directions(
            wheels.x[k] - com[0],
            wheels.y[k] - com[1],
            wheels.heading[k],
            wheels.roller_angle[k],
            wheels.radius[k],
        )
        for k in range(n)
    ]
    along = np.array([contact[0].row for contact in contacts])
    arms = np.array([contact[0].arm for contact in contacts])
    across = np.array([contact[1].row for contact in contacts])
    free_arms = np.array([contact[1].arm for contact in contacts])
    speeds, torques = np.empty((len(times), n)), np.empty((len(times), n))
    rates = np.empty_like(speeds)
    for k, (pose, v, a) in enumerate(zip(poses, velocities, accelerations, strict=True)):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        w, dw = v[2], a[2]
        lever = np.array([c * com[0] - s * com[1], s * com[0] + c * com[1]])
        # Velocity and acceleration of the centre of mass in the world.
        vc = v[:2] + w * np.array([-lever[1], lever[0]])
        ac = a[:2] + dw * np.array([-lever[1], lever[0]]) - w * w * lever
        force = mass * (ac - GRAVITY * np.array(slope))
        local = np.array([c * force[0] + s * force[1], -s * force[0] + c * force[1], inertia * dw])
        twist = np.array([c * vc[0] + s * vc[1], -s * vc[0] + c * vc[1], w])
        change = np.array(
            [
                c * ac[0] + s * ac[1] + w * twist[1],
                -s * ac[0] + c * ac[1] - w * twist[0],
                dw,
            ]
        )
        speeds[k], rates[k] = along @ twist / arms, along @ change / arms
        rolling = across @ twist - free_arms * speeds[k]
        drag = -np.array(friction.roller) * loads * np.sign(np.round(rolling, 9))
        grip = np.linalg.pinv(along.T) @ (local - across.T @ drag)
        shaft = np.array(friction.viscous) * speeds[k]
        shaft += np.array(friction.coulomb) * np.sign(np.round(speeds[k], 9))
        torques[k] = np.array(wheels.inertia) * rates[k] + shaft
        torques[k] += arms * grip + free_arms * drag
    eta = motor.gear_efficiency
    driving = torques * speeds >= 0.0
    constant = motor.torque_constant * motor.gear_ratio
    currents = torques * np.where(driving, 1.0 / eta, eta) / constant
    steps = 0.5 * period * (speeds[1:] + speeds[:-1])
    positions = np.vstack([np.zeros(n), np.cumsum(steps, axis=0)])
    voltages = motor.resistance * currents + constant * speeds
    return FloorDrive(times, positions, times, currents, voltages)
