"""Parameters of Nav2 for a robot by its name and parameter files."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.parameters import build, inline, specs
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.nav2.configuration import Nav2Configuration
from omniman_ros.nodes.mpc_planner.parameters import FootprintOptions
from omniman_ros.processes.checked_parameters import robot_values
from omniman_ros.share import share_path
from omniman_ros.yaml_files import read_yaml


@dataclass(frozen=True, kw_only=True)
class _Robot(Validated):
    """What a robot's file says of what Nav2 needs to know."""

    description: DescriptionParameters = inline()
    limits: TwistLimits
    tool: ToolShape
    load: LoadShape
    footprint: FootprintOptions


#: Names of the parameters that Nav2's depend on
PARAMETERS = frozenset(spec.name for spec in specs(_Robot))


def nav2_parameters(
    robot: str,
    file: str | None = None,
    values: Mapping[str, Any] | None = None,
    *,
    namespace: str = "",
    keeps_out: bool = False,
) -> dict[str, Any]:
    """Return the parameters of Nav2's nodes for a robot; see :func:`robot_values`.

    Args:
        values: `footprint.posture` is the posture in which the arm is driven around.
        keeps_out: Whether the costmaps have zones that the robot keeps out of.

    Raises:
        OmnimanError: A file cannot be read, or a value is refused.
    """
    given = build(_Robot, robot_values(robot, file, values))
    outline = BodyOutline(given.description, given.tool, given.load)
    footprint = outline.footprint(np.array([given.footprint.posture]), 0.0)
    common = read_yaml(share_path("config", "nav2", "nav2.yaml"))
    configuration = Nav2Configuration(
        footprint, given.limits, namespace=namespace.strip("/"), keeps_out=keeps_out
    )
    return configuration.complete(common)
