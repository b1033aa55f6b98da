"""Voltages and electric energy of a motion whose motor currents were planned."""

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.mpc.model import PlanningModel


def motor_voltages(model: PlanningModel, motion: Motion, time: float) -> Array | None:
    """Return the motor voltages (n,) [V] of a motion at a time [s]; None if none are planned."""
    currents = motion.currents_at(time)
    if not np.isfinite(currents).all():
        return None
    pose, velocity = motion.sample(time)
    twist = se2.to_robot(float(pose[2]), velocity)
    volts = model.voltages(currents + model.dry_current(twist), twist)
    limit = model.max_voltage
    clipped: Array = np.clip(volts, -limit, limit)
    return clipped


def expected_energy(model: PlanningModel, motion: Motion) -> float:
    """Return the electric energy that a whole motion is expected to consume [J].

    Spans without planned currents, which are those of a braking, count as zero.
    """
    spans = np.diff(motion.times)
    poses, velocities = motion.at(0.5 * (motion.times[:-1] + motion.times[1:]))
    twists = velocities.copy()
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    twists[:, 0] = cos * velocities[:, 0] + sin * velocities[:, 1]
    twists[:, 1] = cos * velocities[:, 1] - sin * velocities[:, 0]
    currents = np.nan_to_num(motion.currents)
    power = (model.voltages(currents, twists) * currents).sum(axis=1)
    return float((power * spans).sum())
