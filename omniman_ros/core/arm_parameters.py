"""The arm's joints: their names in every message, and what they may do."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter

Floats = tuple[float, ...]

UR_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint",
    "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
"""Names and order of the public UR drivers and of the UR description."""


@dataclass(frozen=True, kw_only=True)
class ArmParameters:
    """Joints of the arm and their limits; one number stands for all joints.

    Names, ranges and speeds are those of the public description of the UR5 (joint_limits.yaml of
    ur_description: +-2 pi but for the elbow, pi rad/s). It has no accelerations: those here are
    well within what the arm can do, and what MoveIt's configuration of it uses.
    """

    joints: tuple[str, ...] = parameter(
        UR_JOINTS, "Names of the joints, from the base on; a prefix goes here.", read_only=True
    )
    lower: Floats = parameter(
        (-math.tau, -math.tau, -math.pi, -math.tau, -math.tau, -math.tau),
        "Least angle of each joint.", unit="rad", low=-math.tau, high=math.tau,
    )  # fmt: skip
    upper: Floats = parameter(
        (math.tau, math.tau, math.pi, math.tau, math.tau, math.tau),
        "Largest angle of each joint.", unit="rad", low=-math.tau, high=math.tau,
    )  # fmt: skip
    velocity: Floats = parameter(
        (math.pi,), "Largest speed of each joint.", unit="rad/s", low=0.001, high=math.pi
    )
    acceleration: Floats = parameter(
        (5.0,), "Largest acceleration of each joint, stops included.", unit="rad/s^2", low=0.01,
        high=40,
    )  # fmt: skip
    jerk: Floats = parameter(
        (50.0,), "Largest jerk of each joint where motion is planned here; stops have none.",
        unit="rad/s^3", low=0.1, high=1e4,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Compare the parameters with each other.

        Raises:
            ParameterError: No joints, a name is there twice, or not one limit a joint.
        """
        n = len(self.joints)
        if n == 0 or len(set(self.joints)) != n or not all(self.joints):
            raise ParameterError("arm.joints", self.joints, "needs different names")
        for label in ("lower", "upper", "velocity", "acceleration", "jerk"):
            if len(getattr(self, label)) not in (1, n):
                raise ParameterError(f"arm.{label}", getattr(self, label), f"one or {n} of them")
        for low, high in zip(self.each("lower"), self.each("upper"), strict=True):
            if not low < high:
                raise ParameterError("arm.lower", self.lower, "must be below arm.upper")

    def each(self, label: str) -> Floats:
        """Limit of each joint.

        Args:
            label: lower, upper, velocity, acceleration or jerk.
        """
        values: Floats = getattr(self, label)
        return values if len(values) == len(self.joints) else values * len(self.joints)
