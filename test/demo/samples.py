"""Recordings of robots that follow their references, made without a robot."""

import math

import numpy as np

from omniman_ros.demo.demo import load_demo
from omniman_ros.demo.figures import ArmMove, TwistPhase
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.recorder import DemoRecording

START = 1000.0
DURATION = 8.0
MOVEMENTS = [
    Interval("there", START, START + 5.0),
    Interval("back", START + 6.0, START + DURATION),
]


def reference_poses(times):
    """Poses (k, 3) of a curve that is driven with a turning heading."""
    return np.column_stack([0.5 + 0.4 * times, 0.2 * np.sin(times), 0.3 + 0.9 * times])


def reference_rows():
    """Rows of `DemoRecording.reference`: previews that overlap, with wrapped headings."""
    rows = []
    for begin in np.arange(0.0, DURATION, 0.04):
        times = begin + 0.008 * np.arange(6)
        poses = reference_poses(times)
        poses[:, 2] = np.remainder(poses[:, 2] + math.pi, math.tau) - math.pi
        rows += [(START + t, *pose) for t, pose in zip(times, poses, strict=True)]
    return rows


def odometry_rows(error=(0.0, 0.0, 0.0), delay=0.0):
    """Rows of `DemoRecording.odom` of a robot with a constant error or a delay [s]."""
    times = np.arange(0.0, DURATION, 0.01)
    poses = reference_poses(times - delay) + error
    return np.column_stack([START + times, poses, np.zeros((len(times), 3))])


def perfect_run():
    """A demo whose figures are all within their limits, and its recording."""
    odom = odometry_rows()
    recording = DemoRecording(
        odom=[tuple(row) for row in odom],
        truth=[tuple(row[:4]) for row in odom],
        coupling=[(START, 0.001), (START + 5.5, 0.1), (START + 7.0, -0.003)],
        reference=reference_rows(),
        energy=[(1.0, 2.0), (4.0, 2.5)],
        commands=(np.arange(2000) * 0.005).tolist(),
    )
    demo = load_demo("omniman", has_arm=False)
    demo.twists = [TwistPhase("rest", 3.0, lambda t: (0.0, 0.0, 0.0), START)]
    demo.movements = MOVEMENTS
    return demo, recording


def arm_run(lag=0.04, offset=0.0):
    """The same of an arm that moves there and back with a delay [s] and a constant error [rad]."""

    def joints(times):
        return np.column_stack([1.0 - np.cos(np.pi * times / 2.0), 0.5 * np.sin(np.pi * times)])

    times = np.arange(0.0, 4.0, 0.008)
    delayed = np.clip(times - lag, 0.0, 4.0)
    demo, recording = perfect_run()
    recording.arm = [(START + t, *q) for t, q in zip(times, joints(delayed) + offset, strict=True)]
    recording.arm_reference = [
        (START + t, *q) for t, q in zip(times, joints(times), strict=True) for _ in range(2)
    ]
    recording.arm_intervals = [0.008] * 500
    demo.arm_moves = [
        ArmMove(tuple(joints(np.array([end - lag]))[0]), START + start, START + end)
        for start, end in ((0.0, 2.0), (2.0, 3.9))
    ]
    return demo, recording
