"""Inverse kinematics per second: the closed form, compared with iterations in numpy and `pin`.

All solve for one pose after the other in Python, as a program that calls them would. `pin` loads
the robot's own URDF and is measured only where it is installed.
"""

import importlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.core.arm_model import JOINTS, ArmModel
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.description.urdf import TOOL, urdf
from omniman_ros.lab.bench.harness import Rows
from omniman_ros.lab.bench.measurement import best_cpu
from omniman_ros.motion.whole_body.model import PLATFORM_AXES, Mount, WholeBodyModel

Solution = tuple[Array, int]
"""Joint angles (6,) [rad], and the number of iterations; -1 where there was no convergence."""
Solve = Callable[[Array, Array, float], Solution]
"""A solver: its arguments are a pose (4, 4) in the base of the DH table, initial joint angles (6,)
[rad] and a tolerance."""

SEED = 8
"""Seed of the random joint angles."""
BATCHES = (1, 100, 10_000)
"""Numbers of poses that the closed form solves at once."""
AT_ONCE = ", ".join(f"{batch:,}" for batch in BATCHES)
INITIAL_OFFSET = 0.1
"""Distance of each joint's initial angle from the solution [rad]."""
TOLERANCES = (1e-4, 1e-9)
"""Norms of the pose error at which an iteration ends, metres and radians alike."""
DAMPING = 1e-12
"""Damping of the least-squares steps."""
STEPS = {"step 0.1, as documented": 0.1, "step 1": 1.0}
"""Shares of a Newton step that the iteration with `pin` takes."""
PIN_ITERATIONS = 1000
"""Most iterations of `pin`'s example."""
NEWTON_ITERATIONS = 100
"""Most iterations of Newton's method with whole steps."""


@dataclass(frozen=True)
class Sample:
    """Random poses to solve for.

    Attributes:
        angles: (n, 6) joint angles of a solution [rad].
        poses: (n, 4, 4) poses of the tool in the base of the DH table.
        near: (n, 6) initial joint angles near the solution [rad].
    """

    angles: Array
    poses: Array
    near: Array

    @classmethod
    def of(cls, model: ArmModel, count: int) -> "Sample":
        """Draw poses: every joint within +-pi, singular configurations included."""
        rng = np.random.default_rng(SEED)
        angles = rng.uniform(-math.pi, math.pi, (count, JOINTS))
        near = angles + INITIAL_OFFSET * rng.choice([-1.0, 1.0], angles.shape)
        return cls(angles, model.forward(angles), near)


class Newton:
    """Solves by whole Newton steps on the arm's own forward kinematics and Jacobian, in numpy.

    Args:
        model: Kinematics of the arm.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Solution:
        """Solve for a pose; see Solve."""
        q = start
        for k in range(NEWTON_ITERATIONS + 1):
            left = pose_error(self._model.forward(q), pose)
            if math.sqrt(float(left @ left)) < tolerance:
                return q, k
            jacobian = self._model.jacobian(q)
            square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
            q = q + jacobian.T @ np.linalg.solve(square, left)
        return q, -1


class PinArm:
    """The arm in `pin`, from the URDF without the wheels.

    Args:
        pin: The module `pinocchio`.
        robot: The robot.
        arm: Parameters of the arm.
        mount: Mount of the arm on the platform.
    """

    def __init__(self, pin: Any, robot: Robot, arm: ArmParameters, mount: Mount) -> None:
        self.pin = pin
        whole = pin.buildModelFromXML(urdf(robot, arm, mount, with_arm=True))
        locked = [i for i, name in enumerate(whole.names) if i and name not in arm.joints]
        self.model = pin.buildReducedModel(whole, locked, pin.neutral(whole))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(TOOL)
        tool = self.model.frames[self.frame]
        self.joint = tool.parentJoint if hasattr(tool, "parentJoint") else tool.parent
        self._after = tool.placement.inverse()
        self._base = pin.SE3(WholeBodyModel(mount).base(np.zeros(len(PLATFORM_AXES))))

    def goal(self, pose: Array) -> Any:
        """Return the pose of the last joint for the tool's pose (4, 4) in the DH table's base."""
        return self._base * self.pin.SE3(pose) * self._after

    def difference(self, angles: Array, body: WholeBodyModel) -> dict[str, float]:
        """Return the largest differences of poses and Jacobians between `pin` and a model.

        Args:
            angles: (n, 6) joint angles [rad].
            body: The model.
        """
        q = np.hstack([np.zeros((len(angles), len(PLATFORM_AXES))), angles])
        poses = body.forward(q)
        jacobians = body.jacobian(q)[:, :, len(PLATFORM_AXES) :]
        pin, model, data = self.pin, self.model, self.data
        worst = np.zeros(2)
        for angle, pose, jacobian in zip(angles, poses, jacobians, strict=True):
            pin.computeJointJacobians(model, data, angle)
            pin.updateFramePlacements(model, data)
            theirs = pin.getFrameJacobian(model, data, self.frame, pin.LOCAL_WORLD_ALIGNED)
            here = data.oMf[self.frame].homogeneous
            worst = np.maximum(worst, [np.abs(here - pose).max(), np.abs(theirs - jacobian).max()])
        return {"pose": float(worst[0]), "jacobian": float(worst[1])}


class PinIteration:
    """Solves by closed-loop inverse kinematics, the example of `pin`'s documentation.

    It takes damped least-squares steps on the logarithm of the pose's error (pinocchio's
    inverse-kinematics.py).

    Args:
        arm: The arm in `pin`.
        step: Share of a Newton step.
    """

    def __init__(self, arm: PinArm, step: float) -> None:
        self._arm, self._step, self._damping = arm, step, DAMPING * np.eye(JOINTS)

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Solution:
        """Solve for a pose; see Solve."""
        arm = self._arm
        pin, model, data, joint = arm.pin, arm.model, arm.data, arm.joint
        goal, q = arm.goal(pose), start
        for k in range(PIN_ITERATIONS + 1):
            pin.forwardKinematics(model, data, q)
            to_goal = data.oMi[joint].actInv(goal)
            left = pin.log6(to_goal).vector
            if math.sqrt(float(left @ left)) < tolerance:
                return q, k
            moved = pin.Jlog6(to_goal.inverse()) @ pin.computeJointJacobian(model, data, q, joint)
            rate = moved.T @ np.linalg.solve(moved @ moved.T + self._damping, left)
            q = pin.integrate(model, q, self._step * rate)
        return q, -1


def pose_error(here: Array, goal: Array) -> Array:
    """Return the error (6,) between two poses (4, 4): translation [m], rotation vector [rad]."""
    turn = goal[:3, :3] @ here[:3, :3].T
    axis = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    sine = math.sqrt(float(axis @ axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return np.concatenate([goal[:3, 3] - here[:3, 3], axis * (angle / sine if sine else 1.0)])


def closed_form(model: ArmModel, sample: Sample, least: float) -> dict[str, Any]:
    """Measure poses per second of the closed form, one and many at once, and its accuracy.

    Args:
        model: Kinematics of the arm.
        sample: Poses to solve for.
        least: Least CPU time of each measurement [s].
    """
    figures: dict[str, Any] = {"all_eight": {}, "one_branch": {}}
    for batch in BATCHES:
        poses = sample.poses[:batch]
        for name, work in (
            ("all_eight", lambda poses=poses: model.inverse(poses)),
            ("one_branch", lambda poses=poses: model.inverse_on_branch(poses, 0)),
        ):
            figures[name][str(batch)] = len(poses) / best_cpu(work, least)
    limit = np.full(JOINTS, math.tau)
    pose, near = sample.poses[0], sample.near[0]
    nearest = best_cpu(lambda: model.nearest(pose, near, -limit, limit), least)
    figures["nearest_of_eight"] = 1.0 / nearest
    found = model.inverse(sample.poses)
    there = np.asarray(np.isfinite(found).all(axis=2), dtype=bool)
    back = np.abs(model.forward(np.where(there[..., None], found, 0.0)) - sample.poses[:, None])
    turned = np.remainder(found - sample.angles[:, None] + math.pi, math.tau) - math.pi
    figures["poses"] = len(sample.poses)
    figures["success"] = float(np.mean(there.any(axis=1)))
    figures["worst_pose_error"] = float(back[there].max())
    figures["worst_angle_error"] = float(np.nanmin(np.abs(turned).max(axis=2), axis=1).max())
    return figures


def iterated(solve: Solve, sample: Sample, count: int) -> dict[str, Any]:
    """Measure solutions per second of an iterative solver, by initial angles and tolerance.

    Args:
        solve: The solver.
        sample: Poses to solve for.
        count: Number of poses; the time of failures counts, too.
    """
    figures: dict[str, Any] = {}
    for name, starts in (("near", sample.near), ("neutral", np.zeros_like(sample.near))):
        for tolerance in TOLERANCES:
            rounds, begin = [], time.process_time()
            for pose, start in zip(sample.poses[:count], starts[:count], strict=True):
                rounds.append(solve(pose, start, tolerance)[1])
            cpu_time = time.process_time() - begin
            good = [k for k in rounds if k >= 0]
            figures[f"{name} {tolerance:g}"] = {
                "per_second": len(good) / cpu_time,
                "success": len(good) / len(rounds),
                "iterations": float(np.median(good)) if good else None,
            }
    return figures


def measured(
    robot: Robot, arm: ArmParameters, mount: Mount, tries: int, least: float
) -> dict[str, Any]:
    """Measure the closed form and all iterative solvers.

    Args:
        robot: The robot.
        arm: Parameters of the arm.
        mount: Mount of the arm on the platform.
        tries: Number of poses that each iterative solver solves.
        least: Least CPU time of each measurement of the closed form [s].
    """
    body = WholeBodyModel(mount)
    sample = Sample.of(body.arm, max(BATCHES))
    result: dict[str, Any] = {"closed_form": closed_form(body.arm, sample, least)}
    others = {"Newton in numpy": iterated(Newton(body.arm), sample, tries)}
    try:
        pin = importlib.import_module("pinocchio")
    except ImportError:
        result["pin"] = None
    else:
        theirs = PinArm(pin, robot, arm, mount)
        result["pin"] = {
            "version": pin.__version__,
            "difference": theirs.difference(sample.angles, body),
        }
        for name, step in STEPS.items():
            others[f"pin, {name}"] = iterated(PinIteration(theirs, step), sample, tries)
    result["iterations"] = others
    ours = result["closed_form"]["one_branch"]
    result["ratios"] = {
        name: {kind: ratios(ours, row["per_second"]) for kind, row in kinds.items()}
        for name, kinds in others.items()
    }
    return result


def ratios(ours: dict[str, float], theirs: float) -> dict[str, float | None]:
    """Return the ratios of the closed form's solutions on one branch to a solver's.

    Args:
        ours: Solutions per second of the closed form, by number of poses at once.
        theirs: Solutions per second of the solver.

    Returns:
        Ratios by number of poses at once; None where the solver found none.
    """
    return {batch: rate / theirs if theirs else None for batch, rate in ours.items()}


def times(ratio: float) -> str:
    """Format a ratio with at least two significant digits."""
    return f"{ratio:,.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def rows(result: dict[str, Any]) -> Rows:
    """Return the rows of the table."""
    ours = result["closed_form"]
    lines: list[tuple[str, ...]] = []
    for name, text in (("all_eight", "all eight solutions"), ("one_branch", "one branch")):
        each = ", ".join(f"{ours[name][str(batch)]:,.0f}" for batch in BATCHES)
        lines.append((f"inverse kinematics, {text}", f"{each} /s", f"{AT_ONCE} poses at once"))
    lines.append(
        (
            "  the nearest of eight, one pose",
            f"{ours['nearest_of_eight']:,.0f} /s",
            f"{100.0 * ours['success']:g} % of {ours['poses']:,} poses, off by at most "
            f"{ours['worst_pose_error']:.1e}",
        )
    )
    for name, kinds in result["iterations"].items():
        for kind, row in kinds.items():
            start, tolerance = kind.split()
            place = f"{INITIAL_OFFSET:g} rad away" if start == "near" else "from zero"
            found = f"{100.0 * row['success']:.1f} % found"
            ratio = result["ratios"][name][kind]
            if all(ratio.values()):
                found += f"; one branch over it: {', '.join(map(times, ratio.values()))}"
            lines.append(
                (f"  {name}, {place}, to {tolerance}", f"{row['per_second']:,.0f} /s", found)
            )
    pin = result["pin"]
    lines.append(
        ("pin", "not installed", "pip install pin")
        if pin is None
        else (
            f"pin {pin['version']}: poses, Jacobians differ by at most",
            f"{pin['difference']['pose']:.1e}, {pin['difference']['jacobian']:.1e}",
            f"{ours['poses']:,} poses",
        )
    )
    return lines
