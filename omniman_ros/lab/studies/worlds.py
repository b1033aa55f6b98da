"""Physics worlds in which studies drive, instead of on the plant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.model.things import person_joints
from omniman_ros.simulation.world.parameters import WorldParameters
from omniman_ros.simulation.world.scene import Column, Person, Scene

if TYPE_CHECKING:  # The command line must do without the engine.
    from omniman_ros.simulation.world.world import World


@dataclass(frozen=True)
class WorldChoice:
    """A physics world: the robot's body and arm, its wheels, and what is around it."""

    description: DescriptionParameters  # robot, arm, and the mount of the arm
    parameters: WorldParameters  # wheels, and what happens in contacts
    scene: Scene = field(default_factory=Scene)  # what is around the robot

    @staticmethod
    def of(
        robot: Mapping[str, Any],
        wheels: str,
        scene: Scene | None = None,
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
        return WorldChoice(build(DescriptionParameters, robot), parameters, scene or Scene())

    def body(self, robot: Robot, simulation: SimulationParameters) -> "World":
        """Return a new world in its initial state."""
        from omniman_ros.simulation.world.world import World

        description = replace(self.description, robot=robot)
        return World(description, simulation, self.parameters, self.scene)


def move_person(world: "World", person: Person, place: Array, velocity: Array) -> None:
    """Put a person at a place, from where it moves on.

    Args:
        place: Position (2,) in the world [m].
        velocity: Velocity (2,) in the world [m/s].
    """
    start = person.x[0], person.y[0]
    engine = world.engine
    for k, joint in enumerate(person_joints(person.name)):
        engine.coordinates[engine.coordinate(joint)] = place[k] - start[k]
        engine.velocities[engine.dof(joint)] = velocity[k]
    engine.refresh()


def place_column(world: "World", column: Column, place: Array) -> None:
    """Put a column at a place.

    Args:
        place: Position (2,) in the world [m].
    """
    world.engine.place(world.engine.body(column.name), float(place[0]), float(place[1]))
