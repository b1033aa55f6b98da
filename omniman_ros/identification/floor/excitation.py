"""The drive that excites the platform's dynamics: sums of sines within a square.

x, y and heading each follow a sum of sines whose frequencies and phases are drawn at random; a
smooth envelope starts and ends the drive at rest, where it began. Of many such drives, slowed down
to the robot's limits, the one is taken from which the unknowns follow with the least variance.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.planar import PlanarSample, Triple
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.regressor import FloorModel, SignWidths
from omniman_ros.identification.floor.solution import WINDOW_STEP, WINDOW_WIDTH, expected_variances
from omniman_ros.identification.floor.windows import Windows

SINES = 4  #: Number of sines in each direction
LOWEST, HIGHEST = 0.5, 2.0
"""Bounds of the sines' frequencies over that of the drive's base frequency."""
MIN_RAMP_TIME = 2.0  #: Shortest time in which the envelope rises, and falls [s]
RAMP_ACCELERATION = 0.4  #: Largest acceleration by the envelope alone, over the robot's limit
SMOOTHSTEP_BEND = 5.774  #: Largest second derivative of a smoothstep of degree 5 from 0 to 1
LIMIT_FRACTION = 0.8  #: Largest speed, yaw rate and acceleration over the robot's limits
GRIP_FRACTION = 0.5  #: Largest wheel torque over that at which the wheel would slip
MOTOR_FRACTION = 0.7  #: Largest wheel torque and wheel speed over those that the motor reaches
MIN_DURATION = 15.0  #: Shortest drive [s]
SAMPLE_PERIOD = 0.04  #: Period at which a drive is checked against the limits [s]
COARSE = 3  #: Ratio to it of the period at which torques are checked
CANDIDATES = 12  #: Number of drives from which one is chosen
SLOWER = 0.9  #: Factor on all frequencies by which a drive is slowed down at least
MAX_SLOWDOWNS = 60  #: Number of times that a drive is slowed down before it counts as impossible


@dataclass(frozen=True, eq=False)
class Excitation:
    """A drive from rest to rest, back to where it began."""

    duration: float  #: Duration [s]
    ramp: float  #: Time in which the envelope rises, and in which it falls [s]
    amplitudes: Array  #: (3, s) amplitudes of the sines in x, y and heading [m, m, rad]
    frequencies: Array  #: (3, s) their angular frequencies [rad/s]
    phases: Array  #: (3, s) their phases at the start [rad]
    start: Triple = (0.0, 0.0, 0.0)  #: Pose at its start in odom [m, m, rad]

    def track(self, times: Array) -> tuple[Array, Array, Array]:
        """Return poses, velocities and accelerations (k, 3) relative to the start at (k,) [s]."""
        times = np.clip(times, 0.0, self.duration)
        phase = self.frequencies[:, :, None] * times + self.phases[:, :, None]
        amplitude, frequency = self.amplitudes[:, :, None], self.frequencies[:, :, None]
        sine, cosine = np.sin(phase), np.cos(phase)
        value = (amplitude * sine).sum(axis=1)
        slope = (amplitude * frequency * cosine).sum(axis=1)
        bend = -(amplitude * frequency**2 * sine).sum(axis=1)
        height, rise, curve = self._envelope(times)
        poses = height * value
        velocities = rise * value + height * slope
        accelerations = curve * value + 2.0 * rise * slope + height * bend
        return poses.T, velocities.T, accelerations.T

    def _envelope(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the envelope, a quintic smoothstep up and down, and its two derivatives."""
        falls = times > 0.5 * self.duration
        u = np.minimum(np.where(falls, self.duration - times, times) / self.ramp, 1.0)
        sign = np.where(falls, -1.0, 1.0)
        height = u**3 * (10.0 + u * (6.0 * u - 15.0))
        rise = sign * 30.0 * u**2 * (1.0 - u) ** 2 / self.ramp
        curve = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / self.ramp**2
        return height, rise, curve

    def sample(self, time: float) -> PlanarSample:
        """Return the reference in odom at a time after the start [s]."""
        pose, velocity, acceleration = (row[0] for row in self.track(np.array([time])))
        x, y, heading = self.start
        c, s = math.cos(heading), math.sin(heading)

        def rotated(vector: Array) -> Triple:
            vx, vy, angle = vector.tolist()
            return c * vx - s * vy, s * vx + c * vy, angle

        dx, dy, turn = rotated(pose)
        return PlanarSample(
            (x + dx, y + dy, heading + turn), rotated(velocity), rotated(acceleration)
        )

    def started_at(self, pose: Triple) -> "Excitation":
        """Return the same drive from another pose in odom [m, m, rad]."""
        return replace(self, start=pose)


def choose_excitation(
    robot: Platform, limits: TwistLimits, reach: float, duration: float, seed: int = 0
) -> Excitation:
    """Choose a drive for the identification.

    Args:
        reach: Largest distance of base_link from the start along x and along y [m].

    Raises:
        InputError: The duration or the reach is too short.
    """
    if not duration >= MIN_DURATION:
        raise InputError(f"a drive of {duration:g} s: at least {MIN_DURATION:g} s are needed")
    if not reach > 0.0:
        raise InputError(f"the reach must be above 0, got {reach:g} m")
    rng = np.random.default_rng(seed)
    model = FloorModel(robot)
    drives = [
        _within_limits(_random_drive(rng, limits, reach, duration), robot, limits, reach)
        for _ in range(CANDIDATES)
    ]
    return min(drives, key=lambda drive: _uncertainty(drive, model))


def random_excitation(
    robot: Platform, limits: TwistLimits, reach: float, duration: float, seed: int
) -> Excitation:
    """Return a drive within the limits that is not chosen for anything, to check a result on."""
    rng = np.random.default_rng(seed)
    return _within_limits(_random_drive(rng, limits, reach, duration), robot, limits, reach)


def _random_drive(
    rng: np.random.Generator, limits: TwistLimits, reach: float, duration: float
) -> Excitation:
    """Return a drive that fills the square and is faster than the limits."""
    shape = (3, SINES)
    phases = rng.uniform(0.0, math.tau, shape)
    parts = rng.uniform(0.3, 1.0, shape)
    frequencies = rng.uniform(LOWEST, HIGHEST, shape)
    # Twice the frequency at which a sine as wide as the square has the largest acceleration.
    frequencies[:2] *= 2.0 * math.sqrt(limits.linear_acceleration / reach)
    frequencies[2] *= 2.0 * limits.angular_acceleration / limits.angular_velocity
    acceleration = RAMP_ACCELERATION * limits.linear_acceleration
    ramp = max(MIN_RAMP_TIME, math.sqrt(SMOOTHSTEP_BEND * reach / acceleration))
    return Excitation(duration, min(ramp, 0.5 * duration), parts, frequencies, phases)


def _within_limits(
    drive: Excitation, robot: Platform, limits: TwistLimits, reach: float
) -> Excitation:
    """Fit the amplitudes to the square and to the yaw rate, and slow the drive to its limits."""
    dynamics = PlatformDynamics(robot, PlatformKinematics(robot.wheels))
    times = np.arange(0.0, drive.duration, SAMPLE_PERIOD)
    for _ in range(MAX_SLOWDOWNS):
        drive = _filling(drive, times, limits, reach)
        excess = _speed_excess(drive, times, limits)
        if excess <= 1.0:
            excess = _torque_excess(drive, times[::COARSE], robot, dynamics)
        if excess <= 1.0:
            return drive
        slower = min(1.0 / math.sqrt(excess), SLOWER)
        drive = replace(drive, frequencies=slower * drive.frequencies)
    raise InputError(f"no drive within {reach:.2f} m and the robot's limits was found")


def _filling(drive: Excitation, times: Array, limits: TwistLimits, reach: float) -> Excitation:
    """Scale the amplitudes: positions to the reach, the heading to its limits."""
    poses, velocities, accelerations = drive.track(times)
    position = reach / np.abs(poses[:, :2]).max(axis=0)
    turn = LIMIT_FRACTION * min(
        limits.angular_velocity / np.abs(velocities[:, 2]).max(),
        min(limits.angular_acceleration, limits.angular_deceleration)
        / np.abs(accelerations[:, 2]).max(),
    )
    scale = np.array([*position, turn])
    return replace(drive, amplitudes=drive.amplitudes * scale[:, None])


def _speed_excess(drive: Excitation, times: Array, limits: TwistLimits) -> float:
    """Return the largest ratio of speed and acceleration to what the drive may use."""
    _, velocities, accelerations = drive.track(times)
    acceleration = min(limits.linear_acceleration, limits.linear_deceleration)
    speed = np.hypot(*velocities[:, :2].T).max() / limits.linear_velocity
    change = np.hypot(*accelerations[:, :2].T).max() / acceleration
    return float(max(speed, change)) / LIMIT_FRACTION


def _torque_excess(
    drive: Excitation, times: Array, robot: Platform, dynamics: PlatformDynamics
) -> float:
    """Return the largest ratio of wheel torques and speeds to what the drive may use."""
    wheel_speeds, torques = _wheel_motion(drive, times, robot, dynamics)
    wheels = robot.wheels
    grip = robot.friction.mu * dynamics.loads * wheels.radius * np.cos(wheels.roller_angle)
    allowed = np.minimum(GRIP_FRACTION * grip, MOTOR_FRACTION * dynamics.torque_limit)
    fastest = np.abs(wheel_speeds).max() / (MOTOR_FRACTION * robot.motor.max_speed)
    return float(max((np.abs(torques) / allowed).max(), fastest))


def _wheel_motion(
    drive: Excitation, times: Array, robot: Platform, dynamics: PlatformDynamics
) -> tuple[Array, Array]:
    """Return wheel speeds and torques (k, n) of a drive by the configured parameters."""
    twists, rates = body_motion(*drive.track(times))
    wheel_speeds = twists @ PlatformKinematics(robot.wheels).J.T
    torques = [
        dynamics.platform_torque(twist, rate) + dynamics.friction_torque(twist, speeds)
        for twist, rate, speeds in zip(twists, rates, wheel_speeds, strict=True)
    ]
    return wheel_speeds, np.array(torques)


def body_motion(poses: Array, velocities: Array, accelerations: Array) -> tuple[Array, Array]:
    """Return twists (k, 3) in base_link and their components' derivatives, CCTA 2017 (20).

    Args:
        poses: (k, 3) poses in the world [m, m, rad].
    """
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])

    def rotated(table: Array) -> Array:
        x, y, angle = table.T
        return np.column_stack([c * x + s * y, c * y - s * x, angle])

    twists, rates = rotated(velocities), rotated(accelerations)
    vx, vy, w = twists.T
    rates[:, 0] += w * vy
    rates[:, 1] -= w * vx
    return twists, rates


def _uncertainty(drive: Excitation, model: FloorModel) -> float:
    """Return the sum of the expected variances of all unknowns, each at most its prior one."""
    robot, kinematics = model.robot, model.kinematics
    dynamics = PlatformDynamics(robot, kinematics)
    times = np.arange(0.0, drive.duration, SAMPLE_PERIOD)
    wheel_speeds, torques = _wheel_motion(drive, times, robot, dynamics)
    currents = dynamics.current(torques, wheel_speeds)
    steps = 0.5 * SAMPLE_PERIOD * (wheel_speeds[1:] + wheel_speeds[:-1])
    positions = np.vstack([np.zeros(robot.wheel_count), np.cumsum(steps, axis=0)])
    planned = FloorDrive(times, positions, times, currents, np.full_like(currents, np.nan))
    windows = Windows(planned.start, planned.end, WINDOW_WIDTH, WINDOW_STEP)
    motor = robot.motor
    back_emf = np.full(robot.wheel_count, motor.gear_ratio * motor.torque_constant)
    equations = model.equations(planned, back_emf, windows, SignWidths())
    return float(expected_variances(model, equations).sum())
