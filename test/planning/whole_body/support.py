"""A robot, a straight path of its tool, and what may stand beside it."""

import numpy as np

from omniman_ros.collision.parameters import ToolShape
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions, BodySetup
from omniman_ros.robots import robot_parameters

#: All axes at the start: the arm reaches to the left and forward
START = np.array([0.0, 0.0, 0.0, 0.3, -1.2, 1.9, -2.2, -1.57, 0.0])
ROBOT = robot_parameters("omniman")


def setup(**changes):
    """Return the robot of the paper."""
    path = build(PathInterpolatorParameters, ROBOT)
    return BodySetup(
        build(DescriptionParameters, ROBOT),
        WholeBodyLimits.of_whole_body(path.core, path.arm),
        ToolShape(),
        None,
        path.tool_path,
        build(AvoidanceOptions, changes),
    )


def straight(length):
    """Return poses of the tool along x from the start on."""
    tool = WholeBodyModel(setup().description.mount).forward(START)
    poses = np.repeat(tool[None], 10, axis=0)
    poses[:, 0, 3] += np.linspace(0.1 * length, length, 10)
    return poses


def posts(*places):
    """Return posts of 10 cm radius that stand at places (x, y)."""
    return ObstacleSnapshot(
        standing=UprightObstacles.join(
            [UprightObstacles.cylinder(x, y, 0.1, (0.0, 1.2)) for x, y in places]
        )
    )
