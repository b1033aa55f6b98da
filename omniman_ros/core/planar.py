"""Motion in the plane as plain numbers, for commands that drive a robot through its topics."""

from dataclasses import dataclass

Triple = tuple[float, float, float]
"""A pose (x [m], y [m], heading [rad]), or its first or second derivative in time."""


@dataclass(frozen=True)
class PlanarSample:
    """A planar motion at one time, in the world frame.

    Attributes:
        pose: Pose [m, m, rad].
        velocity: First derivative of the pose [m/s, m/s, rad/s].
        acceleration: Second derivative of the pose [m/s^2, m/s^2, rad/s^2].
    """

    pose: Triple
    velocity: Triple
    acceleration: Triple
