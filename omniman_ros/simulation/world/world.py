"""The physics world: a robot in a scene, moved by the voltages at its motors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.platform import Platform
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.urdf import carries_arm
from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.gear_motor import configure_motors
from omniman_ros.simulation.plant.imu import BaseMotion
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.arm_servo import ArmServo
from omniman_ros.simulation.world.base import Base
from omniman_ros.simulation.world.contacts import RobotContact, RobotContacts
from omniman_ros.simulation.world.crowd import Crowd
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.platform import deck_height
from omniman_ros.simulation.world.model.wheels import free_joint
from omniman_ros.simulation.world.model.world import world_model
from omniman_ros.simulation.world.motor import HingeMotor
from omniman_ros.simulation.world.parameters import IDEAL, WorldParameters
from omniman_ros.simulation.world.scene import Scene
from omniman_ros.simulation.world.tyres import TyreContacts

MAX_DEPTH = 0.02  #: How deep the robot may be in something where it is put [m]


@dataclass(frozen=True)
class Obstacle:
    """Where something that moves truly is."""

    name: str  #: Name of the element
    pose: tuple[float, float, float]  #: Pose of its middle in the world [m, m, rad]
    velocity: tuple[float, float]  #: Velocity (x, y) in the world [m/s]
    size: tuple[float, float, float]  #: Length, width and height [m]
    is_round: bool  #: Whether it is a cylinder; else it is a box


class World:
    """A robot in a scene: a :class:`~omniman_ros.simulation.plant.body.WheeledBody` to the drives.

    The engine moves bodies by rigid-body mechanics with contacts. Motors and gears are those of
    the plant. Nothing here reads a clock: the same calls give the same numbers to the last bit.

    Raises:
        ParameterError: A parameter is refused, or the robot would start in something.
    """

    def __init__(
        self,
        description: DescriptionParameters,
        simulation: SimulationParameters,
        parameters: WorldParameters,
        scene: Scene,
    ) -> None:
        self._description, self._parameters, self._scene = description, parameters, scene
        robot = description.robot
        #: Gear motors of the wheels, in the robot's order
        self.wheels = tuple(HingeMotor() for _ in range(robot.wheel_count))
        configure_motors(self.wheels, robot, simulation)
        self._model = world_model(description, simulation, parameters, scene)
        engine = self.engine = Engine(self._model)
        self._tyres = TyreContacts(engine, robot.wheels.names)
        self._tyres.configure(robot, simulation.plant)
        self._contacts = RobotContacts(engine, parameters.contact_time)
        self._crowd = Crowd(engine, scene, parameters.person_force)
        #: Servo of the arm; None if the robot carries none
        self.arm = ArmServo(engine, description.arm.joints) if carries_arm(robot) else None

        self._drives = [engine.dof(name) for name in robot.wheels.names]
        is_ideal = parameters.wheels == IDEAL
        hinges = [free_joint(name) for name in robot.wheels.names] if is_ideal else []
        self._free = [engine.coordinate(name) for name in hinges]
        deck = deck_height(robot, description.mount.z if self.arm else None)
        self._base = Base(engine, [load.name for load in scene.loads], deck)
        if self.arm is not None:
            self.arm.place(parameters.posture)
        self._base.put(scene.start)
        depth, element = self._contacts.deepest()
        if depth > MAX_DEPTH:
            raise ParameterError(
                "start", scene.start, f"puts the robot {depth:.2f} m into {element}"
            )
        self._external = self._turnover = 0.0
        self._steps = 0
        self._start = engine.energies()

    # pose

    @property
    def base_frame(self) -> tuple[Array, Array]:
        """Position (3,) [m] and rotation (3, 3) of base_link in the world."""
        return self._base.frame

    @property
    def base_motion(self) -> BaseMotion:
        """Motion of base_link, in all six directions."""
        return self._base.motion

    @property
    def pose(self) -> Array:
        """Pose (x, y, heading) of base_link in the world [m, m, rad], (3,); not wrapped."""
        return self._base.pose

    @property
    def twist(self) -> Array:
        """Twist (vx, vy, w) of base_link in its own frame [m/s, m/s, rad/s], (3,)."""
        return self._base.twist

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Put the robot upright at a pose (3,) [m, m, rad]; its motion in its frame continues.

        What lies on the platform is moved with it.
        """
        before = self.pose
        self._base.put(pose)
        depth, element = self._contacts.deepest()
        if depth > MAX_DEPTH:
            self._base.put(before)
            raise InputError(
                f"the robot cannot stand there: it would be {depth:.2f} m in {element}"
            )

    # measurements

    @property
    def wheel_loads(self) -> Array:
        """Load of each wheel in the latest step [N], (n,)."""
        return self._tyres.loads

    @property
    def contacts(self) -> tuple[RobotContact, ...]:
        """Contacts of the robot, but not those of its wheels with the floor."""
        return self._contacts()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Persons and crates."""
        persons = [
            Obstacle(
                person.name,
                (x, y, 0.0),
                (vx, vy),
                (2.0 * person.radius, 2.0 * person.radius, person.height),
                is_round=True,
            )
            for person, (x, y), (vx, vy) in zip(
                self._scene.persons,
                self._crowd.positions.tolist(),
                self._crowd.velocities.tolist(),
                strict=True,
            )
        ]
        crates = []
        for crate in self._scene.crates:
            body = self.engine.body(crate.name)
            position, _ = self.engine.pose(body)
            heading = self.engine.heading(body)
            velocity = self.engine.velocities[self.engine.dof(crate.name) :][:2]
            crates.append(
                Obstacle(
                    crate.name,
                    (float(position[0]), float(position[1]), heading),
                    (float(velocity[0]), float(velocity[1])),
                    (crate.length, crate.width, crate.height),
                    is_round=False,
                )
            )
        return (*persons, *crates)

    @property
    def energy(self) -> EnergyLedger:
        """Energies since the start.

        `external` is the work of the arm's servo, of persons, of gravity and of changes of mass.
        The residual is what the engine loses in contacts other than by slip and drag of the
        wheels, and its error.
        """
        potential, kinetic = self.engine.energies()
        totals = {
            name: sum(getattr(wheel, name) for wheel in self.wheels)
            for name in ("electrical", "copper", "gear", "shaft", "inductive")
        }
        return EnergyLedger(
            external=self._external - (potential - self._start[0]),
            roller=self._tyres.drag_loss,
            slip=self._tyres.slip_loss,
            kinetic=kinetic - self._start[1],
            turnover=self._turnover,
            **totals,
        )

    # time

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self._steps * self.engine.step_time

    def step(self, voltages: Sequence[float]) -> None:
        """Integrate a substep with voltages (n,) [V]; divergence raises an OmnimanError."""
        engine, wheels, drives = self.engine, self.wheels, self._drives
        applied, damping, dry_friction = engine.applied, engine.damping, engine.dry_friction
        velocities, step = engine.velocities, engine.step_time
        if self.arm is not None:
            self.arm.update(self.time)
        self._crowd.update()
        self._tyres.update_grip()
        for dof in drives:
            applied[dof] = 0.0
        work = step * float(applied @ velocities)
        for wheel, dof, voltage in zip(wheels, drives, voltages, strict=True):
            wheel.begin(voltage, step)
            applied[dof], damping[dof] = wheel.torque, wheel.damping
            dry_friction[dof] = wheel.dry

        engine.advance()
        self._contacts.update(self._tyres.update())
        for index in self._free:
            engine.coordinates[index] = 0.0
        engine.refresh()
        self._steps += 1
        if self.arm is not None:
            self.arm.measure(self.time)

        turnover = abs(work)
        for wheel, dof in zip(wheels, drives, strict=True):
            turnover += wheel.finish(step, velocities.item(dof))
        self._turnover += turnover
        self._external += work
        self._base.follow()

    # parameters

    def configure(self, robot: Platform, simulation: SimulationParameters) -> None:
        """Replace robot data and parameters together, also in motion.

        A change of energy by this counts as external work.
        """
        description = replace(self._description, robot=robot)
        model = world_model(description, simulation, self._parameters, self._scene)
        configure_motors(self.wheels, robot, simulation)
        if model != self._model:
            before = sum(self.engine.energies())
            self.engine.replace(model)
            self._external += sum(self.engine.energies()) - before
            self._model = model
        self._tyres.configure(robot, simulation.plant)
        self._description = description
