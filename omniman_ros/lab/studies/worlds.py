"""Physics worlds in which studies drive, instead of on the plant."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.studies.scene_geometry import MovingObstacle, WallRectangle
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world import scene as things
from omniman_ros.simulation.world.parameters import WorldParameters

if TYPE_CHECKING:  # The command line must do without the engine.
    from omniman_ros.simulation.world.world import World

HEIGHT = 2.0  #: height of obstacles and walls [m]


@dataclass(frozen=True)
class WorldChoice:
    """A physics world: the robot's body and arm, its wheels, and what is around it."""

    description: DescriptionParameters  #: robot, arm, and the mount of the arm
    parameters: WorldParameters  #: wheels, and what happens in contacts
    scene: things.Scene = field(default_factory=things.Scene)  #: what is around the robot

    @staticmethod
    def of(
        robot: Mapping[str, Any],
        wheels: str,
        scene: things.Scene | None = None,
        posture: Sequence[float] | None = None,
    ) -> "WorldChoice":
        """Return the world of a robot. Persons in it apply no force: a study moves them.

        Args:
            posture: (6,) angles at which the arm is at first [rad]; None for the default.
        """
        values: dict[str, Any] = {"wheels": wheels, "person_force": 0.0}
        if posture is not None:
            values["posture"] = [*posture]
        parameters = build(WorldParameters, values)
        return WorldChoice(
            build(DescriptionParameters, robot), parameters, scene or things.Scene()
        )

    def body(self, robot: Platform, simulation: SimulationParameters) -> "World":
        """Return a new world in its initial state."""
        from omniman_ros.simulation.world.world import World

        description = replace(self.description, robot=robot)
        return World(description, simulation, self.parameters, self.scene)


def scene_world(
    robot: Mapping[str, Any],
    wheels: str,
    start: Triple,
    obstacles: Sequence[MovingObstacle],
    walls: Sequence[WallRectangle] = (),
    posture: Sequence[float] | None = None,
) -> WorldChoice:
    """Return a scene as a world, in which the engine tells contact: columns and walls.

    Args:
        start: Pose of the robot at the start [m, m, rad].
        posture: (6,) angles of the arm, if the robot has one [rad]; None for the default.
    """
    columns = []
    for k, obstacle in enumerate(obstacles):
        x, y = obstacle.place(0.0).tolist()
        length, width = (2.0 * axis for axis in obstacle.semi_axes)
        columns.append(
            things.Column(
                name=obstacle_name(k),
                x=x,
                y=y,
                yaw=obstacle.angle,
                length=length,
                width=width,
                height=HEIGHT,
            )
        )
    around = things.Scene(
        start=start,
        walls=tuple(_wall(k, wall) for k, wall in enumerate(walls)),
        columns=tuple(columns),
    )
    return WorldChoice.of(robot, wheels, around, posture)


def obstacle_name(index: int) -> str:
    """Return the name in the world of the obstacle with an index in its scene."""
    return f"obstacle {index + 1}"


def _wall(index: int, wall: WallRectangle) -> things.Wall:
    """Return a wall of the world from its middle, heading and length."""
    half = 0.5 * wall.length
    along = half * math.cos(wall.heading), half * math.sin(wall.heading)
    return things.Wall(
        name=f"wall {index + 1}",
        x=(wall.x - along[0], wall.x + along[0]),
        y=(wall.y - along[1], wall.y + along[1]),
        thickness=wall.width,
        height=HEIGHT,
    )


def place_obstacles(world: "World", obstacles: Sequence[MovingObstacle], now: float) -> None:
    """Put the columns of the obstacles that move where they are at a time [s]."""
    for k, obstacle in enumerate(obstacles):
        if not obstacle.is_fixed:
            x, y = obstacle.place(now).tolist()
            world.engine.place(world.engine.body(obstacle_name(k)), x, y)
