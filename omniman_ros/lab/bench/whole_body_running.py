"""`omniman bench whole_body_running`: `whole_body_planner` in the running robot, on physics.

All nodes are processes on simulated time: paths with nothing around beside `path_interpolator`,
and a planner that is killed or frozen on its way. All figures are of the ground truth or of
messages.
"""

import argparse
import os
import signal
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.terminal import say
from omniman_ros.core.arrays import Array
from omniman_ros.lab.bench import running_judge as judge
from omniman_ros.lab.bench.harness import BenchmarkTable, Figure, at_least, at_most, conclude
from omniman_ros.lab.studies import tool_courses
from omniman_ros.lab.studies.avoidance_scenes import AvoidanceScene, SceneGenerator
from omniman_ros.lab.studies.running_body import (
    ENDS,
    RunningBody,
    running_body,
    start,
)
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.processes.robot_setup import WHOLE_BODY_PLANNER, resolve_robot
from omniman_ros.processes.ros_domain import isolate_ros_domain

RMS_AIM = 1.0  #: Aim: largest root mean square of the tool's error in odom [mm]
SPAN, SPARE = 2.5, 10.0  #: Longest duration: times the unhindered one, and added to it [s]
LENGTH, QUICK_LENGTH = 3.0, 1.0  #: Length of the paths with nothing around [m]
COURSES = {
    "straight": tool_courses.straight,
    "S": tool_courses.s_curve,
    "L": tool_courses.corner,
}
DRIVERS = {"path_interpolator": False, WHOLE_BODY_PLANNER: True}
LOST_AT = 0.4  #: Progress at which the planner is lost
REST_TIMEOUT = 15.0  #: Time in which the robot comes to rest without it [s]
WATCHED = 5.0  #: Time for which a robot at rest is watched [s]
CURVE_STEP = 0.002  #: Distance between positions on the tool's path [m]


class RunningBench:
    """Runs robots, each with nodes of its own."""

    def __init__(self, robot: str, folder: Path) -> None:
        self.generator = SceneGenerator(robot)
        self._robot, self._folder, self._setup = resolve_robot(robot), folder, self.generator.setup
        self._model = self.generator.model

    def _running(self, axes: Array, avoids: bool) -> Any:
        joints, posture = self._setup.description.arm.joints, axes[3:].tolist()
        return running_body(self._robot, joints, self._folder, posture, avoids)

    def _motion(
        self, body: RunningBody, scene: AvoidanceScene, axes: Array, limit: float
    ) -> dict[str, Any]:
        """Return the figures of a motion from axes (9,); none if it did not start."""
        rec = body.recording
        driven = judge.span(rec, limit)
        if driven is None:
            return {}
        begin, end = driven
        tool = judge.between(judge.tool_positions(rec, self._model), begin, end)
        result: dict[str, Any] = judge.tool_errors(tool, rec.references, self._curve(scene, axes))
        result["duration_s"] = end - begin
        result["time_ratio"] = (end - begin) / scene.fixed.duration
        if rec.cycles:
            result["cycle"] = judge.cycle_figures(rec, begin, end)
        return result

    def _curve(self, scene: AvoidanceScene, axes: Array) -> Array:
        """Return positions (k, 3) along the path of a scene, from axes (9,)."""
        first = self._model.forward(axes)[None]
        curve = ToolCurve(np.concatenate([first, scene.poses]), self._setup.path)
        count = int(curve.end / CURVE_STEP) + 2
        positions: Array = curve.pose(np.linspace(0.0, curve.end, count))[:, :3, 3]
        return positions

    def course(self, name: str, length: float) -> AvoidanceScene:
        """Return a path with nothing around."""
        poses = tool_courses.course_poses(self._model, COURSES[name], length)
        fixed = self.generator.planner.plan(poses, tool_courses.start()).curve
        return AvoidanceScene(poses, fixed, (), np.zeros((0, 2)), np.zeros((0, 2)))

    def drive(self, name: str, length: float, driver: str) -> dict[str, Any]:
        """Return the figures of a path with nothing around."""
        scene, axes = self.course(name, length), tool_courses.start()
        limit = SPAN * scene.fixed.duration + SPARE
        with self._running(axes, DRIVERS[driver]) as body:
            start(body, scene)
            body.wait(lambda: body.recording.event(*ENDS) is not None, limit)
        result: dict[str, Any] = {
            "course": name,
            "driver": driver,
            **judge.outcome(body.recording),
        }
        result |= judge.largest_accelerations(body.recording)
        return result | self._motion(body, scene, axes, limit)

    def lose(self, number: signal.Signals, length: float) -> dict[str, Any]:
        """Return the figures of a planner that gets a signal on its way."""
        scene, axes = self.course("S", length), tool_courses.start()
        with self._running(axes, avoids=True) as body:
            rec = body.recording
            start(body, scene)
            body.demand(lambda: body.progress >= LOST_AT, 60.0, "the robot did not get far")
            lost = body.session.now()
            os.kill(body.children.pid(WHOLE_BODY_PLANNER), number)
            rest = None
            while rest is None and body.session.now() < lost + REST_TIMEOUT:
                body.wait(lambda: False, judge.REST_TIME)
                rest = judge.rest_time(rec, lost)
            at_rest = body.session.now()
            if number == signal.SIGSTOP:
                os.kill(body.children.pid(WHOLE_BODY_PLANNER), signal.SIGCONT)
            body.wait(lambda: False, WATCHED)
        tool = judge.tool_positions(rec, self._model)
        after = judge.distances_to_curve(
            judge.between(tool, lost, at_rest)[:, 1:], self._curve(scene, axes)
        )
        return {
            "signal": number.name,
            "rest_s": rest,
            "path_max_mm": 1e3 * float(after.max()),
            "path_rest_mm": 1e3 * float(after[-1]),
            "moved_at_rest": judge.movement(rec, at_rest),
            "events_after": [each for each in rec.events if each[0] > lost],
        }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body_running`; return 0, the exit code of a measurement."""
    isolate_ros_domain(os.environ)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick}
    courses, lost = [], []
    length = QUICK_LENGTH if args.quick else LENGTH
    with tempfile.TemporaryDirectory() as folder:
        bench = RunningBench(args.robot, Path(folder))
        for name in ("straight",) if args.quick else COURSES:
            for driver in DRIVERS:
                say(f"{name}, {driver} ...")
                courses.append(bench.drive(name, length, driver))
        for number in (signal.SIGKILL, signal.SIGSTOP):
            say(f"{number.name} ...")
            lost.append(bench.lose(number, length))
    result |= {"courses": courses, "lost": lost}
    return conclude("whole_body_running", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    courses = [course_figure(course) for course in result["courses"]]
    lost = [lost_figure(each) for each in result["lost"]]
    common = ("RMS, max", "to reference")
    return [
        BenchmarkTable(("outcome", "time", *common, "tool", "joints"), courses),
        BenchmarkTable(("at rest after", "tool off its path", "moved at rest"), lost),
        BenchmarkTable(("value",), aimed(result)),
    ]


def course_figure(course: Mapping[str, Any]) -> Figure:
    """Return the row of a path with nothing around."""
    tool, joint = course["tool_acceleration"], course["joint_acceleration"]
    cells = [course["outcome"], f"{course['duration_s']:.1f} s", *errors(course)]
    cells += [f"{tool:.2f} m/s2", f"{joint:.2f} rad/s2"]
    return Figure(f"{course['course']}, {course['driver']}", cells)


def errors(row: Mapping[str, Any]) -> list[str]:
    """Return the tool's errors as text: to its path, and to its reference."""
    names = ("path", "reference")
    return [f"{row[f'{name}_rms_mm']:.2f}, {row[f'{name}_max_mm']:.2f} mm" for name in names]


def lost_figure(row: Mapping[str, Any]) -> Figure:
    """Return the row of a planner that was lost."""
    rest = "-" if row["rest_s"] is None else f"{row['rest_s']:.2f} s"
    moved = row["moved_at_rest"]
    off = f"{row['path_max_mm']:.1f} mm, at rest {row['path_rest_mm']:.1f} mm"
    still = f"{moved['platform_mm']:.1f} mm, {moved['joints_mrad']:.1f} mrad"
    return Figure(row["signal"], (rest, off, still))


def aimed(result: Mapping[str, Any]) -> list[Figure]:
    """Return the rows with aims."""
    driven = [course for course in result["courses"] if course["driver"] == WHOLE_BODY_PLANNER]
    arrived = sum(course["outcome"] == "completed" for course in driven)
    rows = [at_least("paths completed", arrived, len(driven))]
    for name in ("path", "reference"):
        worst = max((course.get(f"{name}_rms_mm", 0.0) for course in driven), default=None)
        rows.append(at_most(f"tool off its {name}, RMS", worst, RMS_AIM, "{:.2f} mm"))
    return rows
