"""`omniman bench whole_body`: planning and streaming of tool paths, inverse kinematics.

All times are CPU times, as the machine may be busy with other work. Planning is compared with
resampling at constant speed, which jumps in velocity; the closed form of the inverse kinematics
with Newton's method in numpy and with `pin`, the Python package of Pinocchio, which loads the
robot's own URDF and is measured only if it is installed.
"""

import argparse
import importlib
import math
import os
import time
from collections.abc import Callable
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
from omniman_ros.description.urdf import TOOL, urdf
from omniman_ros.lab.bench.harness import (
    LENIENT,
    Rows,
    conclude,
    cpu_share_rows,
    running_nodes,
    tables,
)
from omniman_ros.lab.measurement import best_cpu, median_cpu
from omniman_ros.lab.studies.tool_courses import COURSES, POSTURE, start, tool_poses
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlan, ToolPlanner
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain
from omniman_ros.robots import load_robot

PATH_LENGTHS = {100: 4.0, 10_000: 12.0}  # lengths in the plane, by number of poses [m]
STREAMED = ("circle", 10_000)  # path that the running nodes follow
NODES = (
    "platform_controller",
    "path_interpolator",
    "simulated_drive",
    "arm_streamer",
    "simulated_ur",
)
SETTLING_TIME = 2.0  # before each measurement of the nodes [s]
BATCHES = (1, 100, 10_000)  # numbers of poses for which one call of the closed form solves
INITIAL_OFFSET = 0.1  # absolute difference of each joint's initial angle from the solution [rad]
TOLERANCE = 1e-9  # norm of the pose error (m, rad) at which iterations end
DAMPING = 1e-12  # of the least-squares steps, added to the diagonal of J J^T
ITERATIONS = 100  # most steps of an iteration

Solve = Callable[[Array, Array], Array | None]
"""An iterative solver: from the tool's pose (4, 4) in the base frame of the DH table and initial
joint angles (6,) to those of the pose [rad], or None without convergence."""


def plan_figures(
    parameters: PathInterpolatorParameters, poses: Array, repeats: int
) -> dict[str, Any]:
    """Measure the CPU time of planning a path of poses (k, 4, 4), and the quality of the plan."""
    model = WholeBodyModel(parameters.mount)
    limits = WholeBodyLimits.of_whole_body(parameters.core, parameters.arm)
    planner = ToolPlanner(model, limits, parameters.tool_path)
    plan, speed = planner.plan(poses, start()), parameters.tool_path.linear_velocity
    planning = median_cpu(lambda: planner.plan(poses, start()), repeats)
    plain = median_cpu(lambda: resampled(model, poses, speed), repeats)
    q = plan.curve.positions
    # Manipulability is |det J| of the arm alone, after T. Yoshikawa (1985), lengths in metres.
    manipulability = np.abs(np.linalg.det(model.arm.jacobian(q[:, 3:])))
    reach = np.linalg.norm(model.arm.forward(q[:, 3:])[:, :3, 3], axis=1)
    return {
        "planning_ms": 1e3 * planning,
        "plain_resampling_ms": 1e3 * plain,
        "ratio": planning / plain,
        "length_m": plan.length,
        "duration_s": plan.curve.duration,
        "duration_ratio": plan.curve.duration * speed / plan.length,
        "limits_used": limits_used(plan, limits),
        "least_manipulability": float(manipulability.min()),
        "first_manipulability": float(manipulability[0]),
        "largest_reach_m": float(reach.max()),
    }


def resampled(model: WholeBodyModel, poses: Array, speed: float) -> Array:
    """Resample a tool path at constant speed [m/s], with jumps in velocity and without any limits.

    This is the plainest interpolation possible. The tool moves straight from pose to pose, the
    platform moves with it without turning, and the joint angles follow from the inverse kinematics
    in closed form.

    Args:
        poses: (n, 4, 4) poses of the tool in odom, lengths in metres.

    Returns:
        (k, 9) positions of all axes at 125 Hz: platform [m, m, rad], joints [rad].
    """
    here = start()
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(0.0, distance[-1], speed * TICK)
    tool = poses[np.searchsorted(distance, at, side="right") - 1]
    each = [np.interp(at, distance, column) for column in poses[:, :3, 3].T]
    tool[:, :3, 3] = np.column_stack(each)
    platform = np.tile(here[:3], (len(at), 1))
    platform[:, :2] += tool[:, :2, 3] - tool[0, :2, 3]
    branch = model.arm.branch_of(here[3:])
    return np.hstack([platform, model.arm_angles(platform, tool, branch, here[3:])])


def limits_used(plan: ToolPlan, limits: WholeBodyLimits) -> dict[str, Any]:
    """Return the largest share of each limit that a plan uses, and the axis that uses it.

    The limits of odom_x and odom_y hold for the magnitude of both as a vector.
    """
    curve, largest = plan.curve, {}
    for name, values, bounds in (
        ("velocity", curve.velocities, limits.velocity),
        ("acceleration", curve.accelerations, limits.acceleration),
        ("jerk", np.diff(curve.accelerations, axis=0) / TICK, limits.jerk),
    ):
        sizes = np.abs(values)
        sizes[:, :2] = np.hypot(values[:, 0], values[:, 1])[:, None]
        shares = (sizes / bounds).max(axis=0)
        k = int(shares.argmax())
        axis = "odom_xy" if k < 2 else limits.names[k]
        largest[name] = {"share": float(shares[k]), "axis": axis}
    return largest


def measure_shares(robot: str, poses: Array, seconds: float) -> dict[str, Any]:
    """Measure the share of a core that the nodes use, at rest and along a path (k, 4, 4) [m]."""
    initial = f"simulated_arm.initial:={[float(angle) for angle in POSTURE]}"
    setup = RobotSetup(robot=robot, only=NODES, params=(initial, *LENIENT))
    path = Path()
    path.header.frame_id = "odom"
    for pose in poses:
        stamped = PoseStamped()
        arm_conversions.fill_pose(stamped.pose, pose)
        path.poses.append(stamped)
    progress, seen = [0.0], {"tool_pose": 0, "tool_reference": 0}

    def note(topic: str) -> Callable[[PoseStamped], None]:
        return lambda _: seen.update({topic: seen[topic] + 1})

    with running_nodes(robot_processes(setup)) as nodes:
        node = nodes.session.node

        def on_progress(message: Float64) -> None:
            progress.append(message.data)

        node.create_subscription(Float64, "path_progress", on_progress, 10)
        for topic in seen:
            node.create_subscription(PoseStamped, topic, note(topic), 50)
        paths = node.create_publisher(Path, "tool_path", 10)
        nodes.wait(lambda: seen["tool_pose"] > 0, DISCOVERY_TIMEOUT, "no tool_pose")
        heard = "no subscriber of tool_path"
        nodes.wait(lambda: paths.get_subscription_count() > 0, DISCOVERY_TIMEOUT, heard)
        nodes.serve(SETTLING_TIME)
        idle = nodes.cpu_shares(NODES, seconds)
        paths.publish(path)
        nodes.wait(lambda: progress[-1] > 0.0, 30.0, "the robot did not start on the path")
        nodes.serve(min(SETTLING_TIME, seconds))
        before, begin = seen["tool_reference"], time.monotonic()
        driving = nodes.cpu_shares(NODES, seconds)
        rate = (seen["tool_reference"] - before) / (time.monotonic() - begin)
        if not rate > 0.0 or progress[-1] >= 1.0:
            raise CommandError(f"the robot did not follow the path: progress {progress[-1]:.0%}")
    return {"idle": idle, "driving": driving, "previews_per_s": rate}


def newton(model: ArmModel) -> Solve:
    """Return damped Newton steps in numpy, with forward kinematics and Jacobian of `ArmModel`."""

    def solve(pose: Array, q: Array) -> Array | None:
        for _ in range(ITERATIONS):
            error = pose_error(model.forward(q), pose)
            if math.sqrt(float(error @ error)) < TOLERANCE:
                return q
            jacobian = model.jacobian(q)
            square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
            q = q + jacobian.T @ np.linalg.solve(square, error)
        return None

    return solve


def with_pin(
    pin: Any, parameters: PathInterpolatorParameters
) -> tuple[Solve, Callable[[Array], Array]]:
    """Return `pin`'s closed-loop inverse kinematics with whole steps, and its forward kinematics.

    The iteration is the example of Pinocchio's documentation (inverse-kinematics.py). The model is
    made from the robot's URDF, with all other joints locked.
    """
    arm, mount = parameters.arm, parameters.mount
    whole = pin.buildModelFromXML(urdf(parameters.core.robot, arm, mount, with_arm=True))
    locked = [i for i, name in enumerate(whole.names) if i and name not in arm.joints]
    model = pin.buildReducedModel(whole, locked, pin.neutral(whole))
    data, frame = model.createData(), model.getFrameId(TOOL)
    tool = model.frames[frame]
    joint = tool.parentJoint if hasattr(tool, "parentJoint") else tool.parent
    base = pin.SE3(WholeBodyModel(mount).base(np.zeros(len(PLATFORM_AXES))))

    def solve(pose: Array, q: Array) -> Array | None:
        goal = base * pin.SE3(pose) * tool.placement.inverse()
        for _ in range(ITERATIONS):
            pin.forwardKinematics(model, data, q)
            to_goal = data.oMi[joint].actInv(goal)
            error = pin.log6(to_goal).vector
            if math.sqrt(float(error @ error)) < TOLERANCE:
                return q
            local = pin.computeJointJacobian(model, data, q, joint)
            jacobian = pin.Jlog6(to_goal.inverse()) @ local
            square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
            q = pin.integrate(model, q, jacobian.T @ np.linalg.solve(square, error))
        return None

    def forward(q: Array) -> Array:
        pin.framesForwardKinematics(model, data, q)
        return np.asarray((base.inverse() * data.oMf[frame]).homogeneous)

    return solve, forward


def pose_error(here: Array, goal: Array) -> Array:
    """Return the error (6,) of a pose (4, 4): translation [m] and rotation vector [rad]."""
    turn = goal[:3, :3] @ here[:3, :3].T
    pairs = ((2, 1), (0, 2), (1, 0))
    axis = 0.5 * np.array([turn[i, j] - turn[j, i] for i, j in pairs])
    sine = math.sqrt(float(axis @ axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return np.concatenate([goal[:3, 3] - here[:3, 3], axis * (angle / sine if sine else 1.0)])


def measure_inverse(
    parameters: PathInterpolatorParameters, tries: int, block_time: float
) -> dict[str, Any]:
    """Measure poses per second of the closed form, in blocks of a CPU time [s], and of peers."""
    model, random = WholeBodyModel(parameters.mount).arm, np.random.default_rng(8)
    # Uniform joint angles, singular configurations included.
    angles = random.uniform(-math.pi, math.pi, (max(BATCHES), JOINTS))
    near = angles + INITIAL_OFFSET * random.choice([-1.0, 1.0], angles.shape)
    poses = model.forward(angles)
    rates: dict[str, Any] = {"all_eight": {}, "one_branch": {}}
    for batch in BATCHES:
        some = poses[:batch]
        one_branch = best_cpu(partial(model.inverse_on_branch, some, 0), block_time)
        rates["all_eight"][str(batch)] = batch / best_cpu(partial(model.inverse, some), block_time)
        rates["one_branch"][str(batch)] = batch / one_branch
    found = model.inverse(poses)
    exists = np.asarray(np.isfinite(found).all(axis=2), dtype=bool)
    errors = np.abs(model.forward(np.where(exists[..., None], found, 0.0)) - poses[:, None])
    result = {**rates, "success": float(np.mean(exists.any(axis=1)))}
    result["worst_pose_error"] = float(errors[exists].max())
    solvers = {"Newton in numpy": newton(model)}
    try:
        pin = importlib.import_module("pinocchio")
    except ImportError:
        result["pin_difference"] = None
    else:
        solvers["pin, whole steps"], forward = with_pin(pin, parameters)
        off = [np.abs(forward(q) - pose).max() for q, pose in zip(angles, poses, strict=True)]
        result["pin_difference"] = float(max(off))
    result["iterations"] = {}
    for name, solve in solvers.items():
        begin = time.process_time()
        pairs = zip(poses[:tries], near, strict=False)
        solved = sum(solve(pose, q) is not None for pose, q in pairs)
        rate = solved / (time.process_time() - begin)  # the time of failures counts, too
        result["iterations"][name] = {"per_second": rate, "success": solved / tries}
    return result


def run(args: argparse.Namespace) -> int:
    """Run `omniman bench whole_body`; return 0, the exit code of a successful measurement."""
    robot = resolve_robot(args.robot)
    parameters = build(PathInterpolatorParameters, load_robot(robot))
    isolate_ros_domain(os.environ)
    model = WholeBodyModel(parameters.mount)
    plans, tries, block_time, seconds = (1, 10, 0.01, 2.0) if args.quick else (7, 300, 0.3, 12.0)
    result: dict[str, Any] = {"robot": args.robot, "quick": args.quick, "planning": {}}
    say("planning ...")
    for name in ("circle",) if args.quick else COURSES:
        for count, length in PATH_LENGTHS.items():
            poses = tool_poses(model, name, length, count)
            result["planning"][f"{name} {count}"] = plan_figures(parameters, poses, plans)
    say("inverse kinematics ...")
    result["inverse"] = measure_inverse(parameters, tries, block_time)
    say(f"CPU of the nodes, twice {seconds:g} s ...")
    name, count = STREAMED
    poses = tool_poses(model, name, PATH_LENGTHS[count], count)
    result["cpu_share"] = measure_shares(robot, poses, seconds)
    return conclude("whole_body", result, report, args.results)


def report(result: dict[str, Any]) -> list[str]:
    """Return the lines of the report on a result."""
    rows: Rows = [("", "value", "compared with")]
    for label, row in result["planning"].items():
        about = (
            f"planning, {label.split()[0]} of {row['length_m']:.1f} m, {label.split()[1]} poses"
        )
        plain = f"{row['ratio']:.0f} times plain resampling ({row['plain_resampling_ms']:.1f} ms)"
        rows.append((about, f"{row['planning_ms']:.0f} ms", plain))
        longer = f"{row['duration_ratio']:.3f} of length / linear_velocity"
        rows.append(("  duration", f"{row['duration_s']:.2f} s", longer))
        used = row["limits_used"].items()
        limits = (f"{kind} {100 * use['share']:.0f} % ({use['axis']})" for kind, use in used)
        rows.append(("  largest share of a limit that is used", "", ", ".join(limits)))
        first = f"{row['first_manipulability']:.4f} at the start"
        least = f"{row['least_manipulability']:.4f}"
        rows.append(("  smallest manipulability of the arm", least, first))
        reach = f"{row['largest_reach_m']:.3f} m"
        rows.append(("  largest distance of the tool from the arm's base", reach, ""))
    rows += cpu_share_rows(result["cpu_share"], "at rest")
    rows.append(("previews per second", f"{result['cpu_share']['previews_per_s']:.0f}", ""))
    ours = result["inverse"]
    batches = ", ".join(f"{batch:,}" for batch in BATCHES)
    for name in ("all_eight", "one_branch"):
        each = ", ".join(f"{rate:,.0f}" for rate in ours[name].values())
        about = f"inverse kinematics, {name.replace('_', ' ')}"
        rows.append((about, f"{each} /s", f"{batches} poses per call"))
    found = f"{100 * ours['success']:g} % found"
    rows.append(("  largest pose error", f"{ours['worst_pose_error']:.1e}", found))
    for name, row in ours["iterations"].items():
        solved = f"{100 * row['success']:.1f} % solved from {INITIAL_OFFSET:g} rad away"
        rows.append((f"  {name}, to {TOLERANCE:g}", f"{row['per_second']:,.0f} /s", solved))
    off = ours["pin_difference"]
    known = "not installed: pip install pin" if off is None else f"{off:.1e}"
    return tables([*rows, ("pin: largest difference of poses", known, "")])
