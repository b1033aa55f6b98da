"""Parameters of station keeping."""

import math
from dataclasses import dataclass, replace

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class StationOptions(Validated):
    """Options of meeting and keeping a station."""

    linear_velocity: float = parameter(
        1.0, "Largest speed in odom, within the robot's limits.", unit="m/s", low=0.001, high=20
    )
    angular_velocity: float = parameter(
        1.0, "Largest yaw rate, within the robot's limits.", unit="rad/s", low=0.001, high=50
    )
    gain: float = parameter(
        3.0,
        "Rate at which a small distance from the station decays; a large one decays at the "
        "constant deceleration of half the limit.",
        unit="1/s",
        low=0.05,
        high=10,
    )
    reserve: float = parameter(
        0.1,
        "Fraction of the limits on speed, acceleration and jerk that is left to feedback.",
        low=0,
        high=0.9,
    )
    max_distance: float = parameter(
        5.0,
        "Distance from the station above which it is not approached, and is given up.",
        unit="m",
        low=0.01,
        high=1000,
    )
    position_tolerance: float = parameter(
        0.02, "Distance up to which the station counts as kept.", unit="m", low=0.001, high=1
    )
    heading_tolerance: float = parameter(
        0.0175, "Angle up to which the station counts as kept.", unit="rad", low=0.001, high=1
    )


@dataclass(frozen=True)
class LeaderOptions(Validated):
    """The leader: where its odom is, and what counts as a failure of its odometry."""

    odom_x: float = parameter(
        0.0, "Place of the leader's odom in the own odom.", unit="m", low=-1e5, high=1e5
    )
    odom_y: float = parameter(
        0.0, "Place of the leader's odom in the own odom.", unit="m", low=-1e5, high=1e5
    )
    odom_heading: float = parameter(
        0.0, "Heading of the leader's odom in the own odom.", unit="rad", low=-6.3, high=6.3
    )
    timeout: float = parameter(
        0.3, "Age of leader/odom from which the robot brakes.", unit="s", low=0.02, high=10
    )
    radius: float = parameter(
        0.65,
        "Radius of a circle around the leader's base_link that contains it. The approach keeps "
        "this and the own circle apart, unless the station is nearer.",
        unit="m",
        low=0,
        high=100,
    )
    max_position_jump: float = parameter(
        0.1,
        "Distance of a pose from its prediction above which the station is given up.",
        unit="m",
        low=0.001,
        high=1000,
    )
    max_heading_jump: float = parameter(
        0.1,
        "Angle of a pose to its prediction above which the station is given up.",
        unit="rad",
        low=0.001,
        high=4,
    )

    @property
    def odom(self) -> Triple:
        """Pose of the leader's odom in the own odom [m, m, rad]."""
        return self.odom_x, self.odom_y, self.odom_heading


@dataclass(frozen=True, kw_only=True)
class StationParameters(Validated):
    """Robot, limits and options of station keeping."""

    robot: Platform = inline()
    limits: TwistLimits
    station: StationOptions
    leader: LeaderOptions

    @property
    def least_distance(self) -> float:
        """Distance at which the circles around both robots touch [m]."""
        body = self.robot.body
        return self.leader.radius + 0.5 * math.hypot(body.length, body.width)

    def usable_limits(self, scale: float) -> TwistLimits:
        """Return the limits that a reference keeps, with the largest speeds of the options."""
        fraction, limits = scale * (1.0 - self.station.reserve), self.limits
        usable = {name: fraction * getattr(limits, name) for name in limits.__dataclass_fields__}
        for name in ("linear_velocity", "angular_velocity"):
            usable[name] = min(usable[name], getattr(self.station, name))
        return replace(limits, **usable)
