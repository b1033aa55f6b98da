"""Motion in the plane as plain numbers, for commands that drive a robot through its topics."""

from dataclasses import dataclass

#: A pose (x [m], y [m], heading [rad]), or its first or second derivative in time
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class PlanarSample:
    """A planar motion at one time, in the world frame."""

    pose: Triple  #: Pose [m, m, rad]
    velocity: Triple  #: First derivative of the pose [m/s, m/s, rad/s]
    acceleration: Triple  #: Second derivative of the pose [m/s^2, m/s^2, rad/s^2]
