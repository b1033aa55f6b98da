"""Parameters of the arm's joints: their names in all messages, and their limits."""

import math
from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

#: Value of a limit: one for all joints, or one per joint, in the limit's unit
Floats = tuple[float, ...]

UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)  #: Names and order of the joints in the public UR drivers and in the UR description


@dataclass(frozen=True, kw_only=True)
class ArmParameters(Validated):
    """Names and limits of the arm's joints; a limit of a single number applies to all joints.

    Names, ranges and speeds are those of the public description of the UR5 (joint_limits.yaml of
    ur_description: +-2 pi rad, +-pi rad for the elbow, and pi rad/s). That file limits no
    acceleration: the default here is well within the arm's ability, and MoveIt's configuration of
    the arm uses the same.
    """

    joints: tuple[str, ...] = parameter(
        UR_JOINTS,
        "Names of the joints from base to tool, with their prefix if any.",
        read_only=True,
    )
    lower: Floats = parameter(
        (-math.tau, -math.tau, -math.pi, -math.tau, -math.tau, -math.tau),
        "Smallest angle of each joint.",
        unit="rad",
        low=-math.tau,
        high=math.tau,
    )
    upper: Floats = parameter(
        (math.tau, math.tau, math.pi, math.tau, math.tau, math.tau),
        "Largest angle of each joint.",
        unit="rad",
        low=-math.tau,
        high=math.tau,
    )
    velocity: Floats = parameter(
        (math.pi,), "Largest speed of each joint.", unit="rad/s", low=0.001, high=math.pi
    )
    acceleration: Floats = parameter(
        (5.0,),
        "Largest acceleration of each joint, also while it stops.",
        unit="rad/s^2",
        low=0.01,
        high=40,
    )
    jerk: Floats = parameter(
        (50.0,),
        "Largest jerk of each joint in motions planned here; stops are not limited in jerk.",
        unit="rad/s^3",
        low=0.1,
        high=1e4,
    )

    def __post_init__(self) -> None:
        """Check the parameters against each other.

        Raises:
            ParameterError: There are no joints, a name is empty or repeated, a limit has neither
                one value nor one per joint, or a lower limit is not below the upper one.
        """
        super().__post_init__()
        n = len(self.joints)
        if n == 0 or len(set(self.joints)) != n or not all(self.joints):
            raise self._refusal("joints", "must have a different name for each joint")
        for label in ("lower", "upper", "velocity", "acceleration", "jerk"):
            if len(getattr(self, label)) not in (1, n):
                reason = f"must have one value or {n}, one per joint"
                raise self._refusal(label, reason)
        for low, high in zip(self.each("lower"), self.each("upper"), strict=True):
            if not low < high:
                raise self._refusal("lower", "must be below arm.upper")

    def each(self, label: str) -> Floats:
        """Return one kind of limit with one value per joint, in the unit of its parameter.

        Args:
            label: `lower`, `upper`, `velocity`, `acceleration` or `jerk`.
        """
        values: Floats = getattr(self, label)
        return values if len(values) == len(self.joints) else values * len(self.joints)
