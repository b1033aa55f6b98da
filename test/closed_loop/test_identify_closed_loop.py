"""Calibration of the odometry on the simulated plant: drives, fit, and drives with the result."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.arbiter import Source
from omniman_ros.core.preview import Preview
from omniman_ros.identification.odometry.campaign import Accuracy, CalibrationRun, Campaign
from omniman_ros.identification.odometry.drive_plan import (
    MARGIN,
    TARGETS,
    CalibrationMotion,
    Speeds,
    check_shape,
    displacement_to,
    max_reach,
    straight_shape,
)
from omniman_ros.identification.odometry.factor_selection import identify
from omniman_ros.identification.odometry.wheel_integration import forward_matrix, integrate
from test.closed_loop.test_closed_loop import Loop, figure_of_eight

AREA, SPEED = 2.6, 0.6
QUICK = {"limits.angular_velocity": 2.4, "limits.angular_acceleration": 4.0}
BY_TOPIC = Accuracy(0.001, math.radians(0.1))
TAPE = Accuracy(0.003, math.radians(0.3))


def mismatch(seed):
    """Return radii off by up to 2 %, and wheels off by up to 5 mm and 0.5 degrees."""
    rng = np.random.default_rng(seed)
    return {
        "mismatch.radius": tuple(rng.uniform(0.98, 1.02, 4).tolist()),
        "mismatch.offset_x": tuple(rng.uniform(-0.005, 0.005, 4).tolist()),
        "mismatch.offset_y": tuple(rng.uniform(-0.005, 0.005, 4).tolist()),
        "mismatch.heading": tuple(np.radians(rng.uniform(-0.5, 0.5, 4)).tolist()),
    }


def preview_of(motion, start):
    """Return a motion as a preview that starts at a time [s]."""
    times = np.arange(0.0, motion.duration + 0.02, 0.02)
    samples = [motion.sample(time) for time in times]
    columns = (
        np.array([getattr(sample, key) for sample in samples])
        for key in ("pose", "velocity", "acceleration")
    )
    return Preview(start + times, *columns)


def drive(loop, preview):
    """Follow a preview to rest; return wheel positions, true poses and poses by the odometry."""
    assert loop.controller.set_preview(Source.PATH, preview, loop.now) == ""
    wheels, truth, odometry = [], [], []
    while loop.now < preview.end + 0.4:
        wheels.append(loop.drives.wheel_states(loop.now).position)
        truth.append(loop.drives.ground_truth()[0])
        loop.step()
        odometry.append(loop.controller.odometry.pose)
    assert loop.controller.latch.released, loop.controller.latch.status.reason
    return np.array(wheels), np.array(truth), np.array(odometry)


def calibration_runs(loop):
    """Drive the runs of the plan as the command does; return them and the true poses between."""
    parameters = loop.controller.parameters
    speeds = Speeds.within(parameters.limits, SPEED)
    reach = max_reach(AREA, parameters.robot.body)
    poses, runs, heading = [loop.drives.ground_truth()[0]], [], 0.0
    for target in TARGETS:
        wheels = []
        for displacement in (
            displacement_to(tuple(poses[-1]), heading, target.corner, reach),
            (0.0, 0.0, target.turn),
        ):
            start = loop.controller.odometry.pose
            recorded, truth, _ = drive(
                loop,
                preview_of(
                    CalibrationMotion(straight_shape(displacement), start, speeds), loop.now + 0.05
                ),
            )
            wheels.append(recorded)
            corner = np.abs(truth[:, :2]).max()
            assert corner < reach * (1 + MARGIN), "the robot leaves its square"
        heading += target.turn
        runs.append(CalibrationRun(target.corner, np.vstack(wheels)))
        poses.append(truth[-1])
    return tuple(runs), np.array(poses)


def rms(odometry, truth):
    """Return the RMS position error along a path of poses (k, 3)."""
    away = odometry[:, :2] - truth[:, :2]
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def replayed(parameters, wheels, truth):
    """Return the RMS error of the odometry with some parameters along a recorded drive."""
    forward = forward_matrix(parameters.robot.wheels, parameters.odometry)
    return rms(integrate(forward, wheels, tuple(truth[0])), truth)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("robot", "seed", "changes"),
    [("omniman", 1, QUICK)],
)
def test_nine_tenths_of_the_systematic_error_are_removed_on_other_paths(robot, seed, changes):
    loop = Loop(robot, changes, mismatch(seed))
    before = loop.controller.parameters
    runs, poses = calibration_runs(loop)
    measured = tuple(map(tuple, poses.tolist()))
    found = identify(Campaign(before.robot.wheels, runs, measured, BY_TOPIC), before.odometry)
    assert not found.undetermined and not found.outliers
    after = replace(before, odometry=found.parameters)
    loop.controller.configure(after)
    reach = max_reach(AREA, before.robot.body)
    speeds = Speeds.within(before.limits, 0.4)
    curve = CalibrationMotion(check_shape(reach), (0.0, 0.0, 0.0), speeds)
    for make in (
        lambda start: preview_of(curve, start),
        lambda start: figure_of_eight(start, 20.0),
    ):
        loop.drives.set_pose((0.0, 0.0, 0.0))
        loop.controller.set_pose((0.0, 0.0, 0.0))
        wheels, truth, odometry = drive(loop, make(loop.now + 0.05))
        wrong = replayed(before, wheels, truth)
        assert wrong > 0.004
        assert replayed(after, wheels, truth) < 0.1 * wrong
        assert rms(odometry, truth) < 0.1 * wrong, "the controller uses the result"
    by_tape = []
    rng = np.random.default_rng(seed)
    for _ in range(5):
        noise = rng.normal(size=poses.shape) * [TAPE.position, TAPE.position, TAPE.heading]
        measured = tuple(map(tuple, (poses + noise).tolist()))
        found = identify(Campaign(before.robot.wheels, runs, measured, TAPE), before.odometry)
        by_tape.append(replayed(replace(before, odometry=found.parameters), wheels, truth) / wrong)
    assert np.mean(by_tape) < 0.5, "a tape measure removes at least half"
