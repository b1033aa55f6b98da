"""Study of tool paths: its measurements and the effect of the correction."""

from collections import deque
from functools import cache

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.hermite import Hermite
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import StudyError
from omniman_ros.lab.studies.tool_courses import start, tool_poses
from omniman_ros.lab.studies.tool_path import (
    MOST_DEMANDING,
    WHEELS,
    ToolPathCase,
    ToolPathLoop,
    rms,
)
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.robots import robot_parameters

MODEL = WholeBodyModel(Mount())
LENGTH = 0.4
ON, OFF = (build(ToolPathOptions, {"correction": on}) for on in (True, False))


class Arm:
    """Arm that follows its previews with a delay of some cycles."""

    period = 0.008

    def __init__(self, angles, late=0):
        self.angles = deque([angles] * (late + 1), maxlen=late + 1)
        self.curve, self.previews = None, []

    def preview(self, times, positions, velocities, accelerations, now):
        self.curve = Hermite(times, positions, velocities, accelerations)
        self.previews.append((now, times[0], times[-1]))

    def cycle(self, now):
        if self.curve is not None:
            self.angles.append(self.curve.sample(now)[0])
        return self.angles[0]


@cache
def planned(course):
    robot = robot_parameters("omniman")
    limits = WholeBodyLimits.of_whole_body(build(PathParameters, robot), ArmParameters())
    return ToolPlanner(MODEL, limits, ON).plan(tool_poses(MODEL, course, LENGTH), start())


def drive(case, arm=None):
    motion = planned(case.course)
    arm = arm or Arm(motion.curve.positions[0, 3:])
    platform = case.platform(robot_parameters("omniman"))
    return ToolPathLoop(platform, case, motion, MODEL, arm).run()


@cache
def harsh(on):
    return drive(ToolPathCase("S", WHEELS[MOST_DEMANDING], ON if on else OFF))


@pytest.mark.exhaustive
def test_correction_removes_most_of_the_error_of_the_platform():
    with_it, without = harsh(True), harsh(False)
    assert rms(without.error) > 0.0025
    assert rms(with_it.error) < 0.15 * rms(without.error)
    assert with_it.error.max() < 0.003
    assert rms(with_it.turned) < 0.15 * rms(without.turned)
    # The platform itself is not helped by it.
    assert with_it.platform == pytest.approx(without.platform, abs=1e-9)


def test_timed_point_counts_and_not_the_nearest():
    case = ToolPathCase("straight", WHEELS["PI"], OFF)
    motion = planned("straight")
    late = drive(case, Arm(motion.curve.positions[0, 3:], late=10))
    on_time = drive(case)
    shift = (
        motion.tool(on_time.times)[:, :3, 3]
        - MODEL.forward(
            np.hstack(
                [
                    motion.curve.sample(on_time.times)[0][:, :3],
                    motion.curve.sample(on_time.times - 0.08)[0][:, 3:],
                ]
            )
        )[:, :3, 3]
    )
    assert rms(on_time.error) < 5e-4
    assert rms(late.error) == pytest.approx(rms(np.linalg.norm(shift, axis=1)), rel=0.1)
    assert rms(late.error) > 2e-3


def test_arm_that_takes_no_preview_ends_the_drive():
    class Refusing(Arm):
        def preview(self, *_):
            raise InputError("too far")

    with pytest.raises(StudyError, match=r"wheels of the demo: arm/joint_reference: too far"):
        drive(ToolPathCase("S", WHEELS["PI"], ON), arm=Refusing(start()[3:]))
