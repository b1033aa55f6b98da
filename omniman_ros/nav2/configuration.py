"""Parameters of Nav2 for a robot: what a file of Nav2 for all robots leaves out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from omniman_ros.collision.footprint import Footprint
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.arrays import Array

LENGTHWAYS, SIDEWAYS = 0.8, 0.6
"""Shares of the limits along x and y, which Nav2 limits one by one: together they make 1."""
INFLATION = 0.1  #: Distance by which costs reach beyond the robot's farthest point [m]
#: Fraction of the largest yaw rate at which Nav2's recovery behaviours turn at least
MIN_YAW_RATE_FRACTION = 0.2
FILTER = "keepout_filter"  #: Name of the layer that keeps the robot out of zones

Parameters = dict[str, Any]  #: Values and groups of values by name, as in a parameter file


@dataclass(frozen=True)
class Nav2Configuration:
    """What Nav2 needs to know of a robot."""

    #: Bounds of platform, arm, tool and load in the posture that Nav2 drives in
    footprint: Footprint
    limits: TwistLimits  #: Limits of the platform's twist, which `platform_controller` holds
    namespace: str = ""  #: Namespace of the robot and of Nav2's nodes; empty for none
    keeps_out: bool = False  #: Whether the costmaps have zones that the robot keeps out of

    @property
    def outline(self) -> Array:
        """Convex outline (k, 2) of the robot in base_link, counter-clockwise [m]."""
        points = self.footprint.whole.corners.reshape(-1, 2)
        result: Array = points[ConvexHull(points).vertices]
        return result

    def complete(self, common: Mapping[str, Any]) -> Parameters:
        """Return the parameters of all of Nav2's nodes.

        Args:
            common: Parameters that are the same for all robots.
        """
        horizon = common["controller_server"]["ros__parameters"]["FollowPath"]
        way = horizon["time_steps"] * horizon["model_dt"] * self._fastest[0]
        edge = math.ceil(2.0 * (way + self._radius))
        own = {
            "controller_server": {"FollowPath": self._controller | {"prune_distance": way}},
            "velocity_smoother": self._smoother,
            "behavior_server": self._behaviours,
            "costmap_filter_info_server": {"mask_topic": f"{self._prefix}/keepout_mask"},
        }
        costmaps = {
            "local_costmap": self._costmap | {"width": edge, "height": edge},
            "global_costmap": self._costmap,
        }
        result = merged(common, {node: {"ros__parameters": own[node]} for node in own})
        result = merged(
            result, {name: {name: {"ros__parameters": costmaps[name]}} for name in costmaps}
        )
        return {self.namespace: result} if self.namespace else result

    @property
    def _prefix(self) -> str:
        """What comes before topics of the costmaps, which have namespaces of their own."""
        return f"/{self.namespace}" if self.namespace else ""

    @property
    def _radius(self) -> float:
        return float(np.hypot(*self.outline.T).max())

    @property
    def _fastest(self) -> tuple[float, float, float]:
        speed = self.limits.linear_velocity
        return LENGTHWAYS * speed, SIDEWAYS * speed, self.limits.angular_velocity

    @property
    def _controller(self) -> Parameters:
        x, y, yaw_rate = self._fastest
        faster, slower = self.limits.linear_acceleration, self.limits.linear_deceleration
        return {
            "vx_max": x,
            "vx_min": -x,
            "vy_max": y,
            "wz_max": yaw_rate,
            "ax_max": LENGTHWAYS * faster,
            "ax_min": -LENGTHWAYS * slower,
            "ay_max": SIDEWAYS * faster,
            "ay_min": -SIDEWAYS * slower,
            "az_max": self.limits.angular_acceleration,
        }

    @property
    def _smoother(self) -> Parameters:
        faster, slower = self.limits.acceleration, self.limits.deceleration
        fractions = np.array((LENGTHWAYS, SIDEWAYS, 1.0))
        return {
            "max_velocity": list(self._fastest),
            "min_velocity": [-value for value in self._fastest],
            "max_accel": (fractions * (faster[0], *faster)).tolist(),
            "max_decel": (-fractions * (slower[0], *slower)).tolist(),
        }

    @property
    def _behaviours(self) -> Parameters:
        return {
            "max_rotational_vel": self.limits.angular_velocity,
            "min_rotational_vel": MIN_YAW_RATE_FRACTION * self.limits.angular_velocity,
            "rotational_acc_lim": self.limits.angular_acceleration,
        }

    @property
    def _costmap(self) -> Parameters:
        corners = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in self.outline.tolist())
        result: Parameters = {
            "footprint": f"[{corners}]",
            "inflation_layer": {"inflation_radius": round(self._radius + INFLATION, 2)},
            "obstacle_layer": {"scan": {"topic": f"{self._prefix}/scan"}},
            FILTER: {"filter_info_topic": f"{self._prefix}/keepout_filter_info"},
        }
        return result | ({"filters": [FILTER]} if self.keeps_out else {})


def merged(base: Mapping[str, Any], more: Mapping[str, Any]) -> Parameters:
    """Return nested parameters of which those of `more` take precedence."""
    result = dict(base)
    for name, value in more.items():
        before = result.get(name)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            value = merged(before, value)
        result[name] = value
    return result
