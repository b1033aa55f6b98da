"""Inverse kinematics per second: the closed form, next to iterations in numpy and with `pin`.

All solve for one pose after the other in Python, as a program that calls them would. `pin` gets
the robot's own URDF and is measured only where it is installed.
"""

import importlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arm_model import JOINTS, ArmModel
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.body.model import PLATFORM_AXES, BodyModel, Mount
from omniman_ros.core.robot import Robot
from omniman_ros.description.urdf import TOOL, urdf

Array = NDArray[np.float64]
Found = tuple[Array, int]
"""Joint angles (6,) [rad], and iterations; -1 where there was no convergence."""
Solve = Callable[[Array, Array, float], Found]
"""From a pose (4, 4) in the base of the DH table, a start (6,) [rad] and a tolerance."""

SEED = 8
BATCHES = (1, 100, 10_000)
"""Poses at once."""
AT_ONCE = ", ".join(f"{batch:,}" for batch in BATCHES)
AWAY = 0.1
"""From each joint of the solution to the start of the iterations [rad]."""
TOLERANCES = (1e-4, 1e-9)
"""Norm of what is left, metres and radians as one."""
DAMPING = 1e-12
STEPS = {"step 0.1, as documented": 0.1, "step 1": 1.0}
"""Shares of a Newton step that the iteration with `pin` takes."""
MOST = 1000
"""Iterations of `pin`'s example ..."""
MOST_PLAIN = 100
"""... and of the plain one, which takes whole steps."""


@dataclass(frozen=True)
class Sample:
    """Joint angles (n, 6) [rad], their poses (n, 4, 4) in the base, and starts near them."""

    angles: Array
    poses: Array
    near: Array

    @classmethod
    def of(cls, model: ArmModel, count: int) -> "Sample":
        """Random ones: every joint within half a turn, singular ones not left out."""
        rng = np.random.default_rng(SEED)
        angles = rng.uniform(-math.pi, math.pi, (count, JOINTS))
        near = angles + AWAY * rng.choice([-1.0, 1.0], angles.shape)
        return cls(angles, model.forward(angles), near)


class Newton:
    """Whole Newton steps on the arm's own forward kinematics and Jacobian, in numpy.

    Args:
        model: Of the arm.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Found:
        """Joint angles for a pose; see Solve."""
        q = start
        for k in range(MOST_PLAIN + 1):
            left = off(self._model.forward(q), pose)
            if math.sqrt(float(left @ left)) < tolerance:
                return q, k
            jacobian = self._model.jacobian(q)
            square = jacobian @ jacobian.T + DAMPING * np.eye(JOINTS)
            q = q + jacobian.T @ np.linalg.solve(square, left)
        return q, -1


class PinArm:
    """The arm in `pin`: from the URDF, with the wheels left out.

    Args:
        pin: The module `pinocchio`.
        robot, arm, mount: What the URDF is made from.
    """

    def __init__(self, pin: Any, robot: Robot, arm: ArmParameters, mount: Mount) -> None:
        self.pin = pin
        whole = pin.buildModelFromXML(urdf(robot, arm, mount, with_arm=True))
        held = [i for i, name in enumerate(whole.names) if i and name not in arm.joints]
        self.model = pin.buildReducedModel(whole, held, pin.neutral(whole))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(TOOL)
        tool = self.model.frames[self.frame]
        self.joint = tool.parentJoint if hasattr(tool, "parentJoint") else tool.parent
        self._after = tool.placement.inverse()
        self._base = pin.SE3(BodyModel(mount).base(np.zeros(len(PLATFORM_AXES))))

    def goal(self, pose: Array) -> Any:
        """Where the last joint is when the tool is at a pose (4, 4) in the base of the table."""
        return self._base * self.pin.SE3(pose) * self._after

    def difference(self, angles: Array, body: BodyModel) -> dict[str, float]:
        """Largest difference of poses and of Jacobians from ours, at joint angles (n, 6) [rad]."""
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
    """Closed-loop inverse kinematics, the example of `pin`'s documentation.

    Damped least squares on the logarithm of the pose's error, inverse-kinematics.py.

    Args:
        arm: It.
        step: Share of a Newton step.
    """

    def __init__(self, arm: PinArm, step: float) -> None:
        self._arm, self._step, self._damping = arm, step, DAMPING * np.eye(JOINTS)

    def __call__(self, pose: Array, start: Array, tolerance: float) -> Found:
        """Joint angles for a pose; see Solve."""
        arm = self._arm
        pin, model, data, joint = arm.pin, arm.model, arm.data, arm.joint
        goal, q = arm.goal(pose), start
        for k in range(MOST + 1):
            pin.forwardKinematics(model, data, q)
            to_goal = data.oMi[joint].actInv(goal)
            left = pin.log6(to_goal).vector
            if math.sqrt(float(left @ left)) < tolerance:
                return q, k
            moved = pin.Jlog6(to_goal.inverse()) @ pin.computeJointJacobian(model, data, q, joint)
            rate = moved.T @ np.linalg.solve(moved @ moved.T + self._damping, left)
            q = pin.integrate(model, q, self._step * rate)
        return q, -1


def off(here: Array, goal: Array) -> Array:
    """What (6,) is between two poses (4, 4): way [m] and rotation vector [rad], in the base."""
    turn = goal[:3, :3] @ here[:3, :3].T
    axis = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    sine = math.sqrt(float(axis @ axis))
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return np.concatenate([goal[:3, 3] - here[:3, 3], axis * (angle / sine if sine else 1.0)])


def cpu(work: Callable[[], object], least: float) -> float:
    """CPU time of a call [s]: the best of three blocks that take some time [s] at least."""
    best = math.inf
    for _ in range(3):
        calls, begin = 0, time.process_time()
        while (taken := time.process_time() - begin) < least or not calls:
            work()
            calls += 1
        best = min(best, taken / calls)
    return best


def closed_form(model: ArmModel, sample: Sample, least: float) -> dict[str, Any]:
    """Poses per second of the closed form, alone and many at once; and how exact it is.

    Args:
        model: Of the arm.
        sample: What is solved for.
        least: CPU time of each measurement [s].
    """
    figures: dict[str, Any] = {"all_eight": {}, "one_branch": {}}
    for batch in BATCHES:
        poses = sample.poses[:batch]
        for name, work in (
            ("all_eight", lambda poses=poses: model.inverse(poses)),
            ("one_branch", lambda poses=poses: model.inverse_on(poses, 0)),
        ):
            figures[name][str(batch)] = len(poses) / cpu(work, least)
    limit = np.full(JOINTS, math.tau)
    pose, near = sample.poses[0], sample.near[0]
    nearest = cpu(lambda: model.nearest(pose, near, -limit, limit), least)
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
    """Solutions per second of an iteration, by start and tolerance.

    Args:
        solve: It.
        sample: What is solved for.
        count: For so many poses; failures take their time.
    """
    figures: dict[str, Any] = {}
    for name, starts in (("near", sample.near), ("neutral", np.zeros_like(sample.near))):
        for tolerance in TOLERANCES:
            rounds, begin = [], time.process_time()
            for pose, start in zip(sample.poses[:count], starts[:count], strict=True):
                rounds.append(solve(pose, start, tolerance)[1])
            taken = time.process_time() - begin
            good = [k for k in rounds if k >= 0]
            figures[f"{name} {tolerance:g}"] = {
                "per_second": len(good) / taken,
                "success": len(good) / len(rounds),
                "iterations": float(np.median(good)) if good else None,
            }
    return figures


def measured(
    robot: Robot, arm: ArmParameters, mount: Mount, tries: int, least: float
) -> dict[str, Any]:
    """All of it.

    Args:
        robot, arm, mount: What the URDF is made from.
        tries: Poses that each iteration is measured with.
        least: CPU time of each measurement of the closed form [s].
    """
    body = BodyModel(mount)
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
            "version": pin.__version__, "difference": theirs.difference(sample.angles, body),
        }  # fmt: skip
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
    """Our solutions on one branch over theirs, by poses at once; None where they find none."""
    return {batch: rate / theirs if theirs else None for batch, rate in ours.items()}


def times(ratio: float) -> str:
    """A ratio with two digits at least."""
    return f"{ratio:,.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Lines of the table."""
    ours = result["closed_form"]
    lines: list[tuple[str, ...]] = []
    for name, text in (("all_eight", "all eight solutions"), ("one_branch", "one branch")):
        each = ", ".join(f"{ours[name][str(batch)]:,.0f}" for batch in BATCHES)
        lines.append((f"inverse kinematics, {text}", f"{each} /s", f"{AT_ONCE} poses at once"))
    lines.append(
        ("  the nearest of eight, one pose", f"{ours['nearest_of_eight']:,.0f} /s",
         f"{100.0 * ours['success']:g} % of {ours['poses']:,} poses, off by at most "
         f"{ours['worst_pose_error']:.1e}")
    )  # fmt: skip
    for name, kinds in result["iterations"].items():
        for kind, row in kinds.items():
            start, tolerance = kind.split()
            place = f"{AWAY:g} rad away" if start == "near" else "from zero"
            found = f"{100.0 * row['success']:.1f} % found"
            ratio = result["ratios"][name][kind]
            if all(ratio.values()):
                found += f"; one branch over it: {', '.join(map(times, ratio.values()))}"
            lines.append(
                (f"  {name}, {place}, to {tolerance}", f"{row['per_second']:,.0f} /s", found)
            )
    pin = result["pin"]
    lines.append(
        ("pin", "not installed", "pip install pin") if pin is None
        else (f"pin {pin['version']}: our poses, Jacobians differ by at most",
              f"{pin['difference']['pose']:.1e}, {pin['difference']['jacobian']:.1e}",
              f"{ours['poses']:,} poses")
    )  # fmt: skip
    return lines
