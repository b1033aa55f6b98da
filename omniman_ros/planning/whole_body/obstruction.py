"""What is in the way of a motion of the whole body: where, which part, and which obstacle."""

import enum
from dataclasses import dataclass


class Cause(enum.Enum):
    """Why a motion must not be followed; the values are those of the key `obstruction`."""

    STANDING = "standing obstacle"
    MOVING = "moving obstacle"
    SELF = "own part"
    REACH = "reach"
    JOINT_LIMIT = "joint limit"
    REVOLUTION = "half a revolution"
    SINGULARITY = "singularity"
    JOINT_SPEED = "joint speed"
    JOINT_ACCELERATION = "joint acceleration"
    WHEEL_SPEED = "wheel speed"
    TIPPING = "tip-over margin"
    PROGRAM = "program"


TEXTS = {
    Cause.STANDING: "{part} has no room beside {other}",
    Cause.MOVING: "{part} has no room beside {other}, which moves",
    Cause.SELF: "{part} would come too near to {other}",
    Cause.REACH: "the platform finds no place from which the arm reaches the tool",
    Cause.JOINT_LIMIT: "{part} would be beyond its limit",
    Cause.REVOLUTION: "{part} would be half a revolution away from its start",
    Cause.SINGULARITY: "the arm would be too close to a singularity",
    Cause.JOINT_SPEED: "{part} would be too fast",
    Cause.JOINT_ACCELERATION: "{part} would accelerate too much",
    Cause.WHEEL_SPEED: "{part} would be too fast",
    Cause.TIPPING: "the robot would be too close to tipping over",
    Cause.PROGRAM: "{other}",
}  #: Sentences for each cause


@dataclass(frozen=True)
class Obstruction:
    """What is in the way."""

    cause: Cause  #: Why the motion must not be followed
    path_parameter: float  #: Place on the path of the tool [m]
    #: Name of the part of the robot that has no room, or of the axis; empty if none
    part: str = ""
    #: Name of the obstacle, or of the robot's own part that is too near; the reason of the solver
    #: if it has no plan; empty if none.
    other: str = ""

    @property
    def reason(self) -> str:
        """What a user is told, without the place."""
        return TEXTS[self.cause].format(part=self.part, other=self.other)

    def __str__(self) -> str:
        return f"{self.path_parameter:.2f} m along the path, {self.reason}"


def status_values(found: Obstruction | None) -> list[tuple[str, object]]:
    """Return what is in the way by the keys of `body/status`; the values are empty for None."""
    keys = ("obstruction", "obstruction_place", "obstruction_part", "obstruction_by")
    values: tuple[object, ...] = ("",) * len(keys)
    if found is not None:
        values = found.cause.value, round(found.path_parameter, 3), found.part, found.other
    return list(zip(keys, values, strict=True))
