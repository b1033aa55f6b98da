"""`omniman bench whole_body`: planning and streaming of tool paths, inverse kinematics.

All times are CPU times, as the machine may be busy with other work. Planning is compared with
resampling at constant speed, which jumps in velocity, the closed form of the inverse kinematics
with Newton's method.
"""

import argparse
import math
import os
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import Float64

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import DISCOVERY_TIMEOUT
from omniman_ros.console.terminal import say
from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arm_model import JOINTS, ArmModel
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.harness import (
    LENIENT,
    BenchmarkTable,
    Figure,
    at_most,
    conclude,
    cpu_share_figures,
    running_nodes,
)
from omniman_ros.lab.measurement import best_cpu, columns_at, median_cpu
from omniman_ros.lab.studies.tool_courses import COURSES, POSTURE, start, tool_poses
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.ur.kinematics import rotation_vector

PATH_LENGTHS = {100: 4.0, 10_000: 12.0}  #: lengths in the plane, by number of poses [m]
STREAMED = ("circle", 10_000)  #: path that the running nodes follow
NODES = (
    "platform_controller",
    "path_interpolator",
    "simulated_drive",
    "arm_streamer",
    "simulated_ur",
)
SETTLING_TIME = 2.0  #: before each measurement of the nodes [s]
BATCHES = (1, 100, 10_000)  #: numbers of poses for which one call of the closed form solves
INITIAL_OFFSET = 0.1  #: absolute difference of each joint's initial angle from the solution [rad]
TOLERANCE = 1e-9  #: norm of the pose error (m, rad) at which iterations end, and aim of ours
DAMPING = 1e-12  #: of the least-squares steps, added to the diagonal of J J^T
ITERATIONS = 100  #: most steps of an iteration


def plan_figures(
    parameters: PathInterpolatorParameters, poses: Array, repeats: int
) -> dict[str, Any]:
    """Measure the CPU time of planning a path of poses (k, 4, 4), and its duration."""
    model = WholeBodyModel(parameters.mount)
    limits = WholeBodyLimits.of_whole_body(parameters.core, parameters.arm)
    planner = ToolPlanner(model, limits, parameters.tool_path)
    plan, speed = planner.plan(poses, start()), parameters.tool_path.linear_velocity
    planning = median_cpu(lambda: planner.plan(poses, start()), repeats)
    plain = median_cpu(lambda: resampled(model, poses, speed), repeats)
    return {
        "planning_ms": 1e3 * planning,
        "plain_resampling_ms": 1e3 * plain,
        "ratio": planning / plain,
        "length_m": plan.length,
        "duration_s": plan.curve.duration,
        "duration_ratio": plan.curve.duration * speed / plan.length,
    }


def resampled(model: WholeBodyModel, poses: Array, speed: float) -> Array:
    """Resample a tool path (n, 4, 4) at constant speed [m/s], with jumps in velocity.

    This is the plainest interpolation possible, without any limits. The tool moves straight from
    pose to pose, the platform moves with it without turning, and the joint angles follow from the
    inverse kinematics in closed form. The result are positions (k, 9) of all axes at 125 Hz:
    platform [m, m, rad], joints [rad].
    """
    here = start()
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(0.0, distance[-1], speed * TICK)
    tool = poses[np.searchsorted(distance, at, side="right") - 1]
    tool[:, :3, 3] = columns_at(np.column_stack([distance, poses[:, :3, 3]]), at)
    platform = np.tile(here[:3], (len(at), 1))
    platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
    branch = model.arm.branch_of(here[3:])
    return np.hstack([platform, model.arm_angles(platform, tool, branch, here[3:])])


def measure_fractions(robot: str, poses: Array, seconds: float) -> dict[str, Any]:
    """Measure the load of a core by the nodes, at rest and along a path (k, 4, 4) [m]."""
    initial = f"simulated_arm.initial:={[float(angle) for angle in POSTURE]}"
    setup = RobotSetup(robot=robot, only=NODES, params=(initial, *LENIENT))
    path = Path()
    path.header.frame_id = "odom"
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    with running_nodes(robot_processes(setup)) as nodes:
        progress = nodes.received(Float64, "path_progress")
        seen = nodes.received(PoseStamped, "tool_pose", 50)
        previews = nodes.received(PoseStamped, "tool_reference", 50)
        paths = nodes.session.node.create_publisher(Path, "tool_path", 10)
        nodes.wait(lambda: bool(seen), DISCOVERY_TIMEOUT, "no tool_pose")
        heard = "no subscriber of tool_path"
        nodes.wait(lambda: paths.get_subscription_count() > 0, DISCOVERY_TIMEOUT, heard)
        nodes.serve(SETTLING_TIME)
        idle = nodes.cpu_fractions(NODES, seconds)
        paths.publish(path)
        begun = lambda: bool(progress) and progress[-1].data > 0.0  # noqa: E731
        nodes.wait(begun, 30.0, "the robot did not start on the path")
        nodes.serve(min(SETTLING_TIME, seconds))
        before, begin = len(previews), time.monotonic()
        driving = nodes.cpu_fractions(NODES, seconds)
        rate = (len(previews) - before) / (time.monotonic() - begin)
        done = progress[-1].data
        if not rate > 0.0 or done >= 1.0:
            raise CommandError(f"the robot did not follow the path: progress {done:.0%}")
    return {"idle": idle, "driving": driving, "previews_per_s": rate}


def newton(model: ArmModel, pose: Array, q: Array) -> bool:
    """Return whether damped Newton steps lead from joint angles (6,) to a pose (4, 4)."""
    for _ in range(ITERATIONS):
        error = pose_error(model.forward(q), pose)
        if math.sqrt(float(error @ error)) < TOLERANCE:
            return True
        jacobian = model.jacobian(q)
        square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
        q = q + jacobian.T @ np.linalg.solve(square, error)
    return False


def pose_error(here: Array, goal: Array) -> Array:
    """Return the error (6,) of a pose (4, 4): translation [m] and rotation vector [rad]."""
    turn = rotation_vector(goal[:3, :3] @ here[:3, :3].T)
    return np.concatenate([goal[:3, 3] - here[:3, 3], turn])


def measure_inverse(model: ArmModel, tries: int, block_time: float) -> dict[str, Any]:
    """Measure poses per second of the closed form, in blocks of a CPU time [s], and of Newton."""
    random = np.random.default_rng(8)
    # Uniform joint angles, singular configurations included.
    angles = random.uniform(-math.pi, math.pi, (max(BATCHES), JOINTS))
    near = angles + INITIAL_OFFSET * random.choice([-1.0, 1.0], angles.shape)
    poses = model.forward(angles)
    rates: dict[str, list[float]] = {"all_eight": [], "one_branch": []}
    for batch in BATCHES:
        some = poses[:batch]
        one_branch = best_cpu(partial(model.inverse_on_branch, some, 0), block_time)
        rates["all_eight"].append(batch / best_cpu(partial(model.inverse, some), block_time))
        rates["one_branch"].append(batch / one_branch)
    found = model.inverse(poses)
    exists = np.asarray(np.isfinite(found).all(axis=2), dtype=bool)
    errors = np.abs(model.forward(np.where(exists[..., None], found, 0.0)) - poses[:, None])
    begin = time.process_time()
    solved = sum(newton(model, poses[k], near[k]) for k in range(tries))
    taken = time.process_time() - begin  # the time of failures counts, too
    return {
        **rates,
        "success": float(np.mean(exists.any(axis=1))),
        "worst_pose_error": float(errors[exists].max()),
        "newton": {"per_second": solved / taken, "success": solved / tries},
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body`; return 0, the exit code of a successful measurement."""
    robot = resolve_robot(args.robot)
    parameters = build(PathInterpolatorParameters, robot_parameters(robot))
    isolate_ros_domain(os.environ)
    model = WholeBodyModel(parameters.mount)
    plans, tries, block_time, seconds = (1, 10, 0.01, 2.0) if args.quick else (7, 300, 0.3, 12.0)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "planning": {}}
    say("planning ...")
    for name in ("circle",) if args.quick else COURSES:
        for count, length in PATH_LENGTHS.items():
            poses = tool_poses(model, name, length, count)
            result["planning"][f"{name}, {count} poses"] = plan_figures(parameters, poses, plans)
    say("inverse kinematics ...")
    result["inverse"] = measure_inverse(model.arm, tries, block_time)
    say(f"CPU of the nodes, twice {seconds:g} s ...")
    name, count = STREAMED
    poses = tool_poses(model, name, PATH_LENGTHS[count], count)
    result["cpu_share"] = measure_fractions(robot, poses, seconds)
    return conclude("whole_body", result, report(result), args.results)


def report(result: Mapping[str, Any]) -> list[BenchmarkTable]:
    """Return the tables of a result."""
    rows = []
    for label, row in result["planning"].items():
        plain = f"{row['ratio']:.0f} times plain resampling ({row['plain_resampling_ms']:.1f} ms)"
        rows.append(Figure(f"planning, {label}", (f"{row['planning_ms']:.0f} ms", plain)))
        longer = f"{row['duration_ratio']:.3f} of length / linear_velocity"
        about = f"  duration, {row['length_m']:.1f} m"
        rows.append(Figure(about, (f"{row['duration_s']:.2f} s", longer)))
    rows += cpu_share_figures(result["cpu_share"], "at rest")
    rate = f"{result['cpu_share']['previews_per_s']:.0f}"
    rows.append(Figure("previews per second", (rate,)))
    ours, peer = result["inverse"], result["inverse"]["newton"]
    batches = ", ".join(f"{batch:,}" for batch in BATCHES) + " poses per call"
    for name in ("all_eight", "one_branch"):
        each = ", ".join(f"{rate:,.0f}" for rate in ours[name])
        about = f"inverse kinematics, {name.replace('_', ' ')}"
        rows.append(Figure(about, (f"{each} /s", batches)))
    solved = f"{peer['success']:.1%} solved from {INITIAL_OFFSET:g} rad away"
    rows.append(Figure("  Newton's method", (f"{peer['per_second']:,.0f} /s", solved)))
    exact = [
        at_most("pose error of the closed form", ours["worst_pose_error"], TOLERANCE),
        Figure("poses for which it finds a solution", (f"{ours['success']:.1%}",)),
    ]
    return [BenchmarkTable(("value", "compared with"), rows), BenchmarkTable(("value",), exact)]
