"""Parameters of nodes whose input may be in other frames than odom."""

from dataclasses import dataclass

from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class OdomFrame(Validated):
    """Name of the odom frame, and whether `map` is another name of it."""

    odom_frame: str = parameter("odom", "Frame of poses and references.", read_only=True)
    map_is_odom: bool = parameter(
        False,
        "Whether `map` is another name of odom; a transform between the two is then ignored.",
        read_only=True,
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the odom frame."""
        return (self.odom_frame, "map") if self.map_is_odom else (self.odom_frame,)

    def beside(self, frame: str) -> tuple[str, ...]:
        """Return all names of a frame, which may be odom."""
        name = frame.lstrip("/")
        return self.names if name in self.names else (name,)


@dataclass(frozen=True, kw_only=True)
class TransformOptions(Validated):
    """Use of the transforms on /tf and /tf_static."""

    wait: float = parameter(
        0.3,
        "Longest time for which a message waits for the transform at its stamp.",
        unit="s",
        low=0.0,
        high=10.0,
    )
    timeout: float = parameter(
        2.0,
        "Age of the newest transform between odom and the frame of a goal, such as `map`, above "
        "which the localisation counts as silent: the robot stops. 0: never. A static transform "
        "has no age.",
        unit="s",
        low=0.0,
        high=3600.0,
    )


@dataclass(frozen=True, kw_only=True)
class FrameParameters(Validated):
    """The odom frame, and the use of transforms into it."""

    odom: OdomFrame = inline()
    tf: TransformOptions
