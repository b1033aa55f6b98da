"""Inverse kinematics per second: the closed form, compared with iterations in numpy and `pin`.

The iterative solvers are called from Python for one pose after the other, as an application would
call them. `pin`, the Python package of Pinocchio, loads the robot's own URDF and is measured only
if it is installed.
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
from omniman_ros.lab.measurement import best_cpu
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel

Solution = tuple[Array, int]
"""Joint angles (6,) [rad], and the number of iterations or -1 without convergence."""
Solve = Callable[[Array, Array, float], Solution]
"""An iterative solver: a function of the tool's pose (4, 4) in the base frame of the DH table,
initial joint angles (6,) [rad], and the norm of the pose error at which it ends."""

SEED = 8  # seed of the random joint angles
BATCHES = (1, 100, 10_000)  # numbers of poses for which one call of the closed form solves
BATCHES_TEXT = ", ".join(f"{batch:,}" for batch in BATCHES)  # `BATCHES` as printed in the table
INITIAL_OFFSET = 0.1  # absolute difference of each joint's initial angle from the solution [rad]
TOLERANCES = (1e-4, 1e-9)
"""Norms of the pose error (translation [m], rotation [rad]) at which an iteration ends."""
DAMPING = 1e-12  # damping of the least-squares steps, added to the diagonal of J J^T
STEPS = {"step 0.1, as documented": 0.1, "step 1": 1.0}
"""Fractions of a Newton step that the iterations with `pin` take, by name in the table."""
PIN_ITERATIONS = 1000  # largest number of iterations with `pin`, that of its example
NEWTON_ITERATIONS = 100  # largest number of iterations of Newton's method with full steps


@dataclass(frozen=True)
class Sample:
    """Random poses for which the solvers solve.

    Attributes:
        poses: (n, 4, 4) poses of the tool in the base frame of the DH table, lengths in metres.
    """

    angles: Array  # (n, 6) joint angles of one solution [rad]
    poses: Array
    near: Array  # (n, 6) initial joint angles near the solution [rad]

    @classmethod
    def draw(cls, model: ArmModel, count: int) -> "Sample":
        """Draw poses from uniform joint angles within +-pi, singular configurations included."""
        rng = np.random.default_rng(SEED)
        angles = rng.uniform(-math.pi, math.pi, (count, JOINTS))
        near = angles + INITIAL_OFFSET * rng.choice([-1.0, 1.0], angles.shape)
        return cls(angles, model.forward(angles), near)


class Newton:
    """Solves by damped Newton steps in numpy, with forward kinematics and Jacobian of `ArmModel`."""

    def __init__(self, model: ArmModel) -> None:
        self._model = model

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Solution:
        """Solve for a pose; see `Solve`."""
        q = start
        for k in range(NEWTON_ITERATIONS + 1):
            error = pose_error(self._model.forward(q), pose)
            if math.sqrt(float(error @ error)) < tolerance:
                return q, k
            jacobian = self._model.jacobian(q)
            square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
            q = q + jacobian.T @ np.linalg.solve(square, error)
        return q, -1


class PinArm:
    """The arm as a model of `pin`, made from the robot's URDF with all other joints locked."""

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
        """Return the pose of the last joint as a `pin.SE3`, in the base frame of the URDF.

        Args:
            pose: (4, 4) pose of the tool in the base frame of the DH table.
        """
        return self._base * self.pin.SE3(pose) * self._after

    def difference(self, angles: Array, body: WholeBodyModel) -> dict[str, float]:
        """Return the largest differences of poses and Jacobians between `pin` and this package.

        Args:
            angles: (n, 6) joint angles [rad].
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
    """Solves by closed-loop inverse kinematics with `pin`, after the example of its documentation.

    It takes damped least-squares steps on the logarithm of the pose error (inverse-kinematics.py
    of Pinocchio).
    """

    def __init__(self, arm: PinArm, step: float) -> None:
        self._arm, self._step, self._damping = arm, step, DAMPING * np.eye(JOINTS)

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Solution:
        """Solve for a pose; see `Solve`."""
        arm = self._arm
        pin, model, data, joint = arm.pin, arm.model, arm.data, arm.joint
        goal, q = arm.goal(pose), start
        for k in range(PIN_ITERATIONS + 1):
            pin.forwardKinematics(model, data, q)
            to_goal = data.oMi[joint].actInv(goal)
            error = pin.log6(to_goal).vector
            if math.sqrt(float(error @ error)) < tolerance:
                return q, k
            local = pin.computeJointJacobian(model, data, q, joint)
            jacobian = pin.Jlog6(to_goal.inverse()) @ local
            square = jacobian @ jacobian.T + self._damping
            step = jacobian.T @ np.linalg.solve(square, error)
            q = pin.integrate(model, q, self._step * step)
        return q, -1


def pose_error(here: Array, goal: Array) -> Array:
    """Return the error of a pose: translation [m] and rotation vector [rad], in the base frame.

    Args:
        here: (4, 4) present pose.
        goal: (4, 4) desired pose.

    Returns:
        (6,) error.
    """
    turn = goal[:3, :3] @ here[:3, :3].T
    axis = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    sine = math.sqrt(float(axis @ axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return np.concatenate([goal[:3, 3] - here[:3, 3], axis * (angle / sine if sine else 1.0)])


def measure_closed_form(model: ArmModel, sample: Sample, min_block_time: float) -> dict[str, Any]:
    """Measure poses per second of the closed form, for one or more poses per call.

    Args:
        min_block_time: Shortest CPU time of a block of calls [s].

    Returns:
        Poses per second, share of the poses with a solution, and largest errors.
    """
    figures: dict[str, Any] = {"all_eight": {}, "one_branch": {}}
    for batch in BATCHES:
        poses = sample.poses[:batch]
        for name, work in (
            ("all_eight", lambda poses=poses: model.inverse(poses)),
            ("one_branch", lambda poses=poses: model.inverse_on_branch(poses, 0)),
        ):
            figures[name][str(batch)] = len(poses) / best_cpu(work, min_block_time)
    limit = np.full(JOINTS, math.tau)
    pose, near = sample.poses[0], sample.near[0]
    nearest = best_cpu(lambda: model.nearest(pose, near, -limit, limit), min_block_time)
    figures["nearest_of_eight"] = 1.0 / nearest
    found = model.inverse(sample.poses)
    exists = np.asarray(np.isfinite(found).all(axis=2), dtype=bool)
    errors = np.abs(model.forward(np.where(exists[..., None], found, 0.0)) - sample.poses[:, None])
    turned = np.remainder(found - sample.angles[:, None] + math.pi, math.tau) - math.pi
    figures["poses"] = len(sample.poses)
    figures["success"] = float(np.mean(exists.any(axis=1)))
    figures["worst_pose_error"] = float(errors[exists].max())
    figures["worst_angle_error"] = float(np.nanmin(np.abs(turned).max(axis=2), axis=1).max())
    return figures


def measure_iteration(solve: Solve, sample: Sample, count: int) -> dict[str, Any]:
    """Measure solutions per second of an iterative solver; the time of failures also counts.

    Returns:
        Figures by initial angles ("near" the solution, or "neutral": zero) and tolerance.
    """
    figures: dict[str, Any] = {}
    for name, starts in (("near", sample.near), ("neutral", np.zeros_like(sample.near))):
        for tolerance in TOLERANCES:
            rounds, begin = [], time.process_time()
            for pose, start in zip(sample.poses[:count], starts[:count], strict=True):
                rounds.append(solve(pose, start, tolerance)[1])
            cpu_time = time.process_time() - begin
            converged = [k for k in rounds if k >= 0]
            figures[f"{name} {tolerance:g}"] = {
                "per_second": len(converged) / cpu_time,
                "success": len(converged) / len(rounds),
                "iterations": float(np.median(converged)) if converged else None,
            }
    return figures


def measure(
    robot: Robot, arm: ArmParameters, mount: Mount, tries: int, min_block_time: float
) -> dict[str, Any]:
    """Measure the closed form and all iterative solvers.

    Args:
        min_block_time: Shortest CPU time of a block of calls of the closed form [s].

    Returns:
        Figures of all solvers, and ratios of their speeds.
    """
    body = WholeBodyModel(mount)
    sample = Sample.draw(body.arm, max(BATCHES))
    result: dict[str, Any] = {"closed_form": measure_closed_form(body.arm, sample, min_block_time)}
    iterations = {"Newton in numpy": measure_iteration(Newton(body.arm), sample, tries)}
    try:
        pin = importlib.import_module("pinocchio")
    except ImportError:
        result["pin"] = None
    else:
        pin_arm = PinArm(pin, robot, arm, mount)
        result["pin"] = {
            "version": pin.__version__,
            "difference": pin_arm.difference(sample.angles, body),
        }
        for name, step in STEPS.items():
            iterations[f"pin, {name}"] = measure_iteration(
                PinIteration(pin_arm, step), sample, tries
            )
    result["iterations"] = iterations
    ours = result["closed_form"]["one_branch"]
    result["ratios"] = {
        name: {kind: ratios(ours, row["per_second"]) for kind, row in kinds.items()}
        for name, kinds in iterations.items()
    }
    return result


def ratios(ours: dict[str, float], theirs: float) -> dict[str, float | None]:
    """Return the ratios of the speed of the closed form on one branch to that of another solver.

    Returns:
        Ratios by number of poses per call; None if the other solver found no solution.
    """
    return {batch: rate / theirs if theirs else None for batch, rate in ours.items()}


def format_ratio(ratio: float) -> str:
    """Format a ratio with at least two significant digits."""
    return f"{ratio:,.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def rows(result: dict[str, Any]) -> Rows:
    """Return the rows of the table for the figures that `measure` returns."""
    ours = result["closed_form"]
    lines: list[tuple[str, ...]] = []
    for name, text in (("all_eight", "all eight solutions"), ("one_branch", "one branch")):
        each = ", ".join(f"{ours[name][str(batch)]:,.0f}" for batch in BATCHES)
        lines.append(
            (f"inverse kinematics, {text}", f"{each} /s", f"{BATCHES_TEXT} poses per call")
        )
    lines.append(
        (
            "  nearest of the eight solutions, one pose per call",
            f"{ours['nearest_of_eight']:,.0f} /s",
            f"{100.0 * ours['success']:g} % of {ours['poses']:,} poses, largest pose error "
            f"{ours['worst_pose_error']:.1e}",
        )
    )
    for name, kinds in result["iterations"].items():
        for kind, row in kinds.items():
            start, tolerance = kind.split()
            place = f"{INITIAL_OFFSET:g} rad away" if start == "near" else "from zero"
            found = f"{100.0 * row['success']:.1f} % solved"
            ratio = result["ratios"][name][kind]
            if all(ratio.values()):
                each = ", ".join(map(format_ratio, ratio.values()))
                found += f"; speed of one branch over this: {each}"
            lines.append(
                (f"  {name}, {place}, to {tolerance}", f"{row['per_second']:,.0f} /s", found)
            )
    pin = result["pin"]
    lines.append(
        ("pin", "not installed", "pip install pin")
        if pin is None
        else (
            f"pin {pin['version']}: largest difference of poses, Jacobians",
            f"{pin['difference']['pose']:.1e}, {pin['difference']['jacobian']:.1e}",
            f"{ours['poses']:,} poses",
        )
    )
    return lines
