"""The drives of a robot on blocks, as their topics show them, and voltages for its motors."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.identify_robot import ALL_OF_THEM, LATCHED, SIM_TIME, parameter_values
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import ANNOUNCED, DISCOVERY, Session
from omniman_ros.cli.terminal import say
from omniman_ros.conversions import joint_arrays, time_seconds
from omniman_ros.core.errors import InputError
from omniman_ros.core.friction_experiment import (
    ExperimentError,
    FrictionExperiment,
    Phase,
    Plan,
)
from omniman_ros.core.parameters import specs
from omniman_ros.core.robot import Robot

Array = NDArray[np.float64]

COMMANDS = ("wheel_voltages", "wheel_commands")
STATES, ELECTRICAL = "wheel_states", "wheel_electrical"
CLOCK = "publish_clock"
PERIOD = 0.01
"""Period of the voltages [s]: half of what the drives' watchdog needs five times over."""
LOOK_AROUND = 0.5
"""Time between two looks for others that command the wheels [s]."""
UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""What DDS gives for a node whose name has not come yet."""
LONGEST_REST = 6.0
"""How long it may take to come to rest [s]; then the drives' watchdog does it."""


@dataclass(frozen=True)
class Drive:
    """The node that turns the wheels, and all of its parameters that were asked for."""

    name: str
    values: dict[str, Any]


def electrical_arrays(message: Float64MultiArray, n: int) -> tuple[Array, Array]:
    """Voltages and currents (n,) [V, A], in the message's order.

    Raises:
        InputError: Other sizes or columns than voltage, current, energy of n wheels.
    """
    labels = [dimension.label for dimension in message.layout.dim]
    if labels[1:] != ["voltage,current,energy"]:
        raise InputError(f"{ELECTRICAL}: columns {labels[1:]}, expected 'voltage,current,energy'")
    if len(message.data) != 3 * n:
        raise InputError(f"{ELECTRICAL}: {len(message.data)} numbers, expected {3 * n}")
    rows = np.array(message.data).reshape(n, 3)
    return rows[:, 0], rows[:, 1]


class Bench:
    """Listens to drives, and gives voltages while nobody else commands them.

    Args:
        session: The ROS node.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end early.
    """

    def __init__(self, session: Session, progress: Progress, poll: Callable[[], None]) -> None:
        self._session, self._progress, self._poll = session, progress, poll
        self._robot: Robot | None = None
        self._order: list[int] | None = None
        self._experiment: FrictionExperiment | None = None
        self._publisher: Any = None
        self._heard: set[str] = set()
        self._stopped: dict[str, str] = {}
        self._emergency = False
        self._fault = ""
        self._looked = 0.0
        self._patient_until = time.monotonic() + ANNOUNCED
        node = session.node
        node.create_subscription(JointState, STATES, self._on_states, ALL_OF_THEM)
        node.create_subscription(Float64MultiArray, ELECTRICAL, self._on_electrical, ALL_OF_THEM)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED)
        for qos in (LATCHED, QoSProfile(depth=10)):
            node.create_subscription(Bool, "emergency_stop", self._on_emergency, qos)

    # ---- what is heard ------------------------------------------------------------------------

    def _on_states(self, message: JointState) -> None:
        if self._robot is None or self._fault:
            return
        names = self._robot.wheels.names
        try:
            position, velocity, _ = joint_arrays(message, names)
            if position is None or velocity is None:
                raise InputError("positions and velocities are needed")
            self._order = [list(message.name).index(name) for name in names]
            if len(message.name) != len(names):
                raise InputError(f"{len(message.name)} names, the robot has {len(names)} wheels")
            if self._experiment is not None:
                stamp = time_seconds(message.header.stamp)
                self._experiment.on_wheels(stamp, position, velocity, time.monotonic())
        except InputError as error:
            self._fault = f"{STATES} cannot be used: {error}"
        self._heard.add(STATES)

    def _on_electrical(self, message: Float64MultiArray) -> None:
        if self._robot is None or self._order is None or self._fault:
            return
        try:
            voltage, current = electrical_arrays(message, len(self._order))
            if self._experiment is not None:
                self._experiment.on_electrical(
                    voltage[self._order], current[self._order], time.monotonic()
                )
        except InputError as error:
            self._fault = f"{ELECTRICAL} cannot be used: {error}"
        self._heard.add(ELECTRICAL)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    def _on_emergency(self, message: Bool) -> None:
        self._emergency = message.data

    @property
    def _is_stopped(self) -> bool:
        return self._emergency or bool(self._stopped)

    # ---- before it begins ---------------------------------------------------------------------

    def wait(self) -> None:
        """Serve ROS for a moment.

        Raises:
            CommandError: Something speaks against going on.
            KeyboardInterrupt: A signal came.
        """
        self._session.spin(0.05)
        self.check()

    def check(self) -> None:
        """Raise where something speaks against going on; see :meth:`wait`."""
        self._poll()
        if self._emergency:
            raise CommandError("the emergency stop is on")
        for name, why in self._stopped.items():
            raise CommandError(f"{name} is {why}: `omniman reset` releases it")
        if self._fault:
            raise CommandError(self._fault)
        now = time.monotonic()
        if now - self._looked > LOOK_AROUND:
            self._looked = now
            self._refuse_others()

    def _refuse_others(self) -> None:
        """Raise where somebody else commands the wheels."""
        for topic in COMMANDS:
            others = self._publishers(topic)
            if self._publisher is not None and self._own in others:
                others.remove(self._own)
            if self._publisher is None and time.monotonic() < self._patient_until:
                others = [name for name in others if UNKNOWN not in name]  # it will be told yet
            if others:
                raise CommandError(
                    f"{', '.join(sorted(set(others)))} publishes '{topic}': two must not command "
                    "the wheels. End it (a node that was killed is seen for 20 s; "
                    "`omniman up --only simulated_drive` starts drives alone)"
                )

    @property
    def _own(self) -> str:
        return str(self._session.node.get_fully_qualified_name())

    def _publishers(self, topic: str) -> list[str]:
        return [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._session.node.get_publishers_info_by_topic(topic)
        ]

    def find_drive(self, extra: tuple[str, ...] = ()) -> Drive:
        """Look who is there, and ask the drive for the robot that it is configured for.

        Args:
            extra: Names of more parameters to ask for.

        Raises:
            CommandError: There is no drive, or more than one, or it runs on simulated time, or
                somebody else commands it.
        """
        self._until(lambda: False, ANNOUNCED)

        def known() -> bool:
            drives = self._publishers(STATES)
            return bool(drives) and not any(UNKNOWN in name for name in drives)

        if not self._until(known, DISCOVERY - ANNOUNCED):
            raise CommandError(
                f"nobody publishes '{STATES}': start the drive node alone, or use --simulate; "
                "are ROS_DOMAIN_ID and --namespace the robot's?"
            )
        drives = sorted(set(self._publishers(STATES)))
        if len(drives) > 1:
            raise CommandError(f"{', '.join(drives)} publish '{STATES}': which one is the robot?")
        client = self._session.node.create_client(GetParameters, f"{drives[0]}/get_parameters")
        if not self._until(client.service_is_ready, DISCOVERY):
            return Drive(drives[0], {})
        asked = [spec.name for spec in specs(Robot)] + [SIM_TIME, CLOCK, *extra]
        values = parameter_values(self._session, client, drives[0], asked)
        if values.get(SIM_TIME) or values.get(CLOCK):
            raise CommandError(f"{drives[0]} runs on simulated time: start it without")
        return Drive(drives[0], values)

    def meet(self, robot: Robot) -> None:
        """Wait until all feedback of a robot is heard, and its drive listens.

        Raises:
            CommandError: It is not in time, or is not the robot's.
        """
        self._robot = robot
        if not self._until(lambda: {STATES, ELECTRICAL} <= self._heard, DISCOVERY):
            absent = ", ".join(sorted({STATES, ELECTRICAL} - self._heard))
            raise CommandError(f"nothing heard within {DISCOVERY:g} s of {absent}")
        self.check()
        if not self._session.node.count_subscribers(COMMANDS[0]):
            raise CommandError(f"nobody listens to '{COMMANDS[0]}': no drive in voltage mode")

    def _until(self, condition: Callable[[], bool], timeout: float) -> bool:
        def checked() -> bool:
            self.check()
            return condition()

        return self._session.wait(checked, timeout)

    # ---- the experiment -----------------------------------------------------------------------

    def turn(self, plan: Plan) -> FrictionExperiment:
        """Run the experiment; the wheels rest when this returns or raises.

        Returns:
            The experiment, with its runs.

        Raises:
            CommandError: It ended early; `experiment` has what was measured.
            KeyboardInterrupt: A signal came.
        """
        assert self._robot is not None
        self.check()
        self._publisher = self._session.node.create_publisher(JointState, COMMANDS[0], 1)
        if not self._until(lambda: self._publisher.get_subscription_count() > 0, DISCOVERY):
            raise CommandError(f"nobody listens to '{COMMANDS[0]}'")
        experiment = FrictionExperiment(self._robot, plan, time.monotonic())
        self._experiment = experiment
        shown = experiment.reached
        self._progress.begin("first turns")
        try:
            while experiment.phase is not Phase.DONE:
                self.check()
                self._give(experiment)
                if experiment.reached != shown:
                    shown = experiment.reached
                    self._show(experiment, plan)
                self._progress.update(experiment.fraction, experiment.phase.value)
        except ExperimentError as error:
            self._come_to_rest(experiment)
            raise CommandError(str(error)) from error
        except BaseException:
            self._come_to_rest(experiment)
            raise
        self._finish(experiment)
        if experiment.begun_again:
            say(f"{experiment.begun_again} times a level was begun again: something was held up.")
        return experiment

    @property
    def experiment(self) -> FrictionExperiment | None:
        """The experiment, once it has begun."""
        return self._experiment

    def _show(self, experiment: FrictionExperiment, plan: Plan) -> None:
        if experiment.runs:
            run = experiment.runs[-1]
            amps = ", ".join(f"{current:.2f}" for current in np.abs(run.current).tolist())
            self._progress.end(f"{np.abs(run.speed).mean():5.1f} rad/s, {amps} A")
        else:
            self._progress.end("the wheels turn freely")
        if experiment.reached < len(plan.levels):
            self._progress.begin(
                f"{experiment.reached + 1}/{len(plan.levels)} "
                f"{plan.levels[experiment.reached]:+.1f} V"
            )

    def _give(self, experiment: FrictionExperiment) -> None:
        """Give the voltages of now, and serve ROS until the next ones are due."""
        begun = time.monotonic()
        self._publish(experiment.volts(begun))
        self._session.spin(begun + PERIOD - time.monotonic())

    def _publish(self, volts: Array) -> None:
        assert self._robot is not None
        message = JointState(name=list(self._robot.wheels.names), effort=volts.tolist())
        message.header.stamp = self._session.node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _come_to_rest(self, experiment: FrictionExperiment) -> None:
        """Ramp down whatever comes: a fault, or another signal, does not end this."""
        self._progress.abandon()
        end = time.monotonic() + LONGEST_REST
        while experiment.phase is not Phase.DONE and time.monotonic() < end:
            # Stopped drives brake by themselves, and hear nothing but zero.
            experiment.end(time.monotonic(), at_once=self._is_stopped)
            self._give(experiment)
        self._finish(experiment)

    def _finish(self, experiment: FrictionExperiment) -> None:
        """Say zero until it is heard, and leave the topic to others."""
        for _ in range(3):
            self._publish(np.zeros(len(experiment.volts(time.monotonic()))))
        self._publisher.wait_for_all_acked(Duration(seconds=1))
        self._session.node.destroy_publisher(self._publisher)
        self._publisher = None
