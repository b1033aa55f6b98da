"""A robot, its limits and tool paths shared by the tests of whole-body motion."""

import math

import numpy as np

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner

MODEL = WholeBodyModel(Mount())
OPTIONS = ToolPathOptions()
ARM = np.array([0.0, -1.9, 2.0, -1.7, -1.57, 0.0])
START = np.concatenate([[0.3, -0.2, 0.4], ARM])


def body_limits(arm: ArmParameters | None = None) -> WholeBodyLimits:
    """Return limits like those of the robot in config/omniman.yaml."""
    joints = AxisLimits.of_arm(arm or ArmParameters())
    side, radius = 0.63, 0.127
    wheels = np.array([[1, -1, -side], [1, 1, side], [1, 1, -side], [1, -1, side]]) / radius
    far = [1e6, 1e6, 1e6]
    return WholeBodyLimits(
        PLATFORM_AXES + joints.names,
        np.concatenate([-np.array(far), joints.lower]),
        np.concatenate([far, joints.upper]),
        np.concatenate([[1.0, 1.0, 1.2], joints.velocity]),
        np.concatenate([[0.8, 0.8, 1.2], joints.acceleration]),
        np.concatenate([[8.0, 8.0, 12.0], joints.jerk]),
        ("m", "m", "rad", *joints.units),
        wheels,
        14.0,
        (0.5, 0.8),
    )


LIMITS = body_limits()
PLANNER = ToolPlanner(MODEL, LIMITS, OPTIONS)


def rotations_about(axis: int, angles) -> np.ndarray:
    """Return rotations (k, 3, 3) about x, y or z."""
    angles = np.atleast_1d(np.asarray(angles, dtype=float))
    i, j = [k for k in range(3) if k != axis]
    result = np.zeros((len(angles), 3, 3))
    result[:, axis, axis] = 1.0
    result[:, i, i] = result[:, j, j] = np.cos(angles)
    sine = np.sin(angles) * (-1.0 if axis == 1 else 1.0)
    result[:, i, j], result[:, j, i] = -sine, sine
    return result


def tool_path(offsets, yaw=0.0, pitch=0.0, roll=0.0, start=START) -> np.ndarray:
    """Return poses (k, 4, 4): offsets (k, 3) from the tool along the heading, and rotations."""
    offsets = np.asarray(offsets, dtype=float)
    now = MODEL.forward(start)
    poses = np.repeat(np.eye(4)[None], len(offsets), axis=0)
    heading = rotations_about(2, start[2])[0]
    turns = (np.broadcast_to(a, len(offsets)) for a in (yaw, pitch, roll))
    yaws, pitches, rolls = (
        rotations_about(axis, a) for axis, a in zip((2, 1, 0), turns, strict=True)
    )
    poses[:, :3, :3] = heading @ yaws @ pitches @ rolls @ heading.T @ now[:3, :3]
    poses[:, :3, 3] = now[:3, 3] + offsets @ heading.T
    return poses


def line(length=4.0, poses=100, start=START) -> np.ndarray:
    """Return a straight line ahead."""
    return tool_path(np.outer(np.linspace(0, length, poses), [1, 0, 0]), start=start)


def circle(radius, tangential, poses=100, start=START) -> np.ndarray:
    """Return one full circle to the left."""
    a = np.linspace(0.0, math.tau, poses)
    offsets = np.column_stack([radius * np.sin(a), radius * (1.0 - np.cos(a)), 0.0 * a])
    return tool_path(offsets, yaw=a if tangential else 0.0, start=start)


def corner() -> np.ndarray:
    """Return an L of three poses with a sharp corner."""
    return tool_path([[0, 0, 0], [1.5, 0, 0], [1.5, 1.5, 0]])


def waves() -> np.ndarray:
    """Return waves of 0.2 m with a nodding tool."""
    s = np.linspace(0.0, 4.0, 150)
    offsets = np.column_stack([s, 0.0 * s, 0.2 * np.sin(2.0 * s)])
    return tool_path(offsets, pitch=0.3 * np.sin(s), roll=0.2 * np.sin(1.5 * s))


def turn(angle) -> np.ndarray:
    """Return a turn in place about the vertical."""
    a = np.linspace(0.0, angle, 60)
    return tool_path(np.zeros((60, 3)), yaw=a)


def random_corners(seed) -> np.ndarray:
    """Return a dozen poses far apart, with rotations."""
    rng = np.random.default_rng(seed)
    offsets = np.cumsum(rng.normal(size=(12, 3)) * [0.3, 0.3, 0.0], axis=0)
    offsets[:, 2] = rng.uniform(-0.2, 0.2, 12)
    offsets -= offsets[0]
    turns = rng.normal(size=(3, 12)) * [[0.3], [0.15], [0.15]]
    turns[:, 0] = 0.0
    return tool_path(offsets, np.cumsum(turns[0]), turns[1], turns[2])


def angle_between(turns, other) -> np.ndarray:
    """Return the angles (k,) [rad] between rotations (k, 3, 3) and another one (3, 3)."""
    away = np.linalg.norm(turns - other, axis=(1, 2)) / math.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(away, 0.0, 1.0))
