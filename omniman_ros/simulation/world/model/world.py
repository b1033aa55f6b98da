"""The whole model: a robot in a scene."""

from collections import Counter
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from omniman_ros.core.errors import ParameterError
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.ur5 import ARM_MASS
from omniman_ros.description.urdf import carries_arm
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.model.arm import add_arm, tool_of
from omniman_ros.simulation.world.model.elements import add_elements
from omniman_ros.simulation.world.model.floor import Tyres, add_floor, tyres_of
from omniman_ros.simulation.world.model.mjcf import add
from omniman_ros.simulation.world.model.platform import add_platform, deck_height
from omniman_ros.simulation.world.parameters import IDEAL, WorldParameters
from omniman_ros.simulation.world.scene import Scene

MAX_SUBSTEP = 0.001  #: Longest step: at 2 ms, energy rises by 5 to 14 % [s]


@dataclass(frozen=True)
class WorldModel:
    """A model to be compiled."""

    xml: str  #: The model in MJCF
    tyres: Tyres  #: Contact of the wheels with the floor


def world_model(
    description: DescriptionParameters,
    simulation: SimulationParameters,
    parameters: WorldParameters,
    scene: Scene,
) -> WorldModel:
    """Return the model of a robot in a scene, with the robot at the origin.

    Raises:
        ParameterError: The substep is too long, the platform is to be lifted, a mismatch has
            neither one value nor one per wheel, or an element of the scene has the name of a part
            of the robot.
    """
    plant, robot = simulation.plant, description.robot
    if plant.substep > MAX_SUBSTEP:
        reason = f"must be at most {MAX_SUBSTEP:g} s in a physics world"
        raise ParameterError("plant.substep", plant.substep, reason)
    if plant.lifted:
        raise ParameterError("plant.lifted", True, "a physics world has no blocks to stand on")
    armed = carries_arm(robot)
    mount = description.mount.z if armed else None
    tool = tool_of(robot)
    mass = robot.body.mass + (ARM_MASS + tool.mass if armed else 0.0)
    mass += sum(load.mass for load in scene.loads)
    tyres = tyres_of(robot, mass, plant, parameters.tyre_stiffness)

    root = Element("mujoco", model="world")
    add(root, "compiler", angle="radian", eulerseq="XYZ", autolimits="true")
    option = add(
        root,
        "option",
        timestep=plant.substep,
        gravity=(0.0, 0.0, -plant.gravity),
        integrator="discrete",
        cone="elliptic",
        impratio=tyres.impratio,
        # Rollers make a large and almost empty matrix.
        jacobian="auto" if parameters.wheels == IDEAL else "sparse",
    )
    # A state that is not finite is reported, and not silently replaced by the first one.
    add(option, "flag", autoreset="disable")
    assets, world = add(root, "asset"), add(root, "worldbody")
    add_floor(world)
    base = add_platform(assets, world, robot, simulation.mismatch, mount, tyres, parameters)
    if armed:
        add_arm(base, description.arm, description.mount, tool)
    add_elements(assets, world, scene, deck_height(robot, mount))
    _require_unique_names(world)
    return WorldModel(ElementTree.tostring(root, encoding="unicode"), tyres)


def _require_unique_names(world: Element) -> None:
    for tags in (("body",), ("joint", "freejoint")):
        names = Counter(element.get("name") for tag in tags for element in world.iter(tag))
        repeated = [name for name, count in names.items() if name and count > 1]
        if repeated:
            reason = "an element of the scene has the name of a part of the robot or of another"
            raise ParameterError("name", repeated[0], reason)
