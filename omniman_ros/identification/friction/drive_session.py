"""Execution of the friction experiment over ROS, from the drives' topics to motor voltages."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import ANNOUNCEMENT_TIME, DISCOVERY_TIMEOUT, Session
from omniman_ros.console.terminal import say
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import joint_arrays
from omniman_ros.conversions.wheels import electrical_arrays
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import specs
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.experiment import ExperimentPhase, FrictionExperiment
from omniman_ros.identification.friction.level_samples import ExperimentError
from omniman_ros.identification.friction.voltage_plan import VoltagePlan
from omniman_ros.identification.node_access import LATCHED, LOSSLESS, SIM_TIME, read_parameters

VOLTAGES = "wheel_voltages"  #: Topic of the voltages for the motors
COMMAND_TOPICS = (VOLTAGES, "wheel_commands")  #: Topics that command the wheels
STATES = "wheel_states"  #: Topic of the wheels' positions and speeds
ELECTRICAL = "wheel_electrical"  #: Topic of the motors' voltages and currents
PUBLISHES_CLOCK = "publish_clock"  #: Parameter: whether the drive publishes simulated time
PERIOD = 0.01  #: Period of the voltages [s]: a tenth of the time of the drives' watchdog
PUBLISHER_CHECK_PERIOD = 0.5  #: Time between two searches for other publishers [s]
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"  #: What DDS reports for a node whose name is not known yet
REST_TIMEOUT = 6.0  #: Longest time to bring the wheels to rest [s]; then the watchdog does


@dataclass(frozen=True)
class DriveNode:
    """The node that drives the wheels."""

    name: str  #: Fully qualified name of the node
    values: dict[str, Any]  #: Values of the parameters that were read from the node, by name


class DriveSession:
    """Runs a friction experiment on drives, as long as no other node commands them.

    Whatever prevents or ends the experiment raises a CommandError, and a signal a
    KeyboardInterrupt; `experiment` then has the measured runs.

    Args:
        poll: Called many times a second; raises to end early.
    """

    def __init__(
        self,
        session: Session,
        progress: Progress,
        poll: Callable[[], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session, self._progress = session, progress
        self._poll, self._clock = poll, clock
        self._robot: Platform | None = None
        self._order: list[int] | None = None
        self._experiment: FrictionExperiment | None = None
        self._publisher: Any = None
        self._received: set[str] = set()
        self._stop_reasons: dict[str, str] = {}
        self._is_emergency = False
        self._feedback_error = ""
        self._last_publisher_check = -np.inf
        self._names_expected_at = clock() + ANNOUNCEMENT_TIME
        node = session.node
        node.create_subscription(JointState, STATES, self._on_states, LOSSLESS)
        node.create_subscription(Float64MultiArray, ELECTRICAL, self._on_electrical, LOSSLESS)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED)
        for qos in (LATCHED, QoSProfile(depth=10)):
            node.create_subscription(Bool, "emergency_stop", self._on_emergency, qos)

    # ---- topics -------------------------------------------------------------------------------

    def _on_states(self, message: JointState) -> None:
        if self._robot is None or self._feedback_error:
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
                self._experiment.on_wheels(stamp, position, velocity, self._clock())
        except InputError as error:
            self._feedback_error = f"{STATES} cannot be used: {error}"
        self._received.add(STATES)

    def _on_electrical(self, message: Float64MultiArray) -> None:
        if self._robot is None or self._order is None or self._feedback_error:
            return
        try:
            voltage, current = electrical_arrays(message, len(self._order))
            if self._experiment is not None:
                self._experiment.on_electrical(
                    voltage[self._order], current[self._order], self._clock()
                )
        except InputError as error:
            self._feedback_error = f"{ELECTRICAL} cannot be used: {error}"
        self._received.add(ELECTRICAL)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self._stop_reasons[message.name] = message.message
        else:
            self._stop_reasons.pop(message.name, None)

    def _on_emergency(self, message: Bool) -> None:
        self._is_emergency = message.data

    # ---- before the experiment ----------------------------------------------------------------

    def wait(self) -> None:
        """Serve ROS for a moment, and check that nothing prevents the experiment."""
        self._session.spin(0.05)
        self.check()

    def check(self) -> None:
        """Check that nothing prevents the experiment."""
        self._poll()
        if self._is_emergency:
            raise CommandError("the emergency stop is on")
        for name, reason in self._stop_reasons.items():
            raise CommandError(f"{name} is {reason}: `omniman reset` releases it")
        if self._feedback_error:
            raise CommandError(self._feedback_error)
        now = self._clock()
        if now - self._last_publisher_check > PUBLISHER_CHECK_PERIOD:
            self._last_publisher_check = now
            self._refuse_other_publishers()

    def _refuse_other_publishers(self) -> None:
        for topic in COMMAND_TOPICS:
            others = self._publishers(topic)
            if self._publisher is not None and self._own_name in others:
                others.remove(self._own_name)
            if self._publisher is None and self._clock() < self._names_expected_at:
                # A name that is still unknown will arrive in time.
                others = [name for name in others if UNKNOWN_NODE not in name]
            if others:
                raise CommandError(
                    f"{', '.join(sorted(set(others)))} publishes '{topic}': two must not command "
                    "the wheels. End it (a node that was killed is still listed for 20 s; "
                    "`omniman up --only simulated_drive` starts drives alone)"
                )

    @property
    def _own_name(self) -> str:
        return str(self._session.node.get_fully_qualified_name())

    def _publishers(self, topic: str) -> list[str]:
        return [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._session.node.get_publishers_info_by_topic(topic)
        ]

    def find_drive(self, more_parameters: tuple[str, ...] = ()) -> DriveNode:
        """Find the drive, and read the configuration of its robot."""
        self._wait_until(lambda: False, ANNOUNCEMENT_TIME)

        def is_known() -> bool:
            drives = self._publishers(STATES)
            return bool(drives) and not any(UNKNOWN_NODE in name for name in drives)

        if not self._wait_until(is_known, DISCOVERY_TIMEOUT - ANNOUNCEMENT_TIME):
            raise CommandError(
                f"nobody publishes '{STATES}': start the drive node alone, or use --simulate; "
                "are ROS_DOMAIN_ID and --namespace the robot's?"
            )
        drives = sorted(set(self._publishers(STATES)))
        if len(drives) > 1:
            raise CommandError(f"{', '.join(drives)} publish '{STATES}': which one is the robot?")
        client = self._session.node.create_client(GetParameters, f"{drives[0]}/get_parameters")
        if not self._wait_until(client.service_is_ready, DISCOVERY_TIMEOUT):
            return DriveNode(drives[0], {})
        names = [spec.name for spec in specs(Platform)]
        names += [SIM_TIME, PUBLISHES_CLOCK, *more_parameters]
        values = read_parameters(self._session, client, drives[0], names)
        if values.get(SIM_TIME) or values.get(PUBLISHES_CLOCK):
            raise CommandError(f"{drives[0]} runs on simulated time: start it without")
        return DriveNode(drives[0], values)

    def connect(self, robot: Platform) -> None:
        """Wait until all feedback of a robot is received and its drive accepts voltages."""
        self._robot = robot
        if not self._wait_until(lambda: {STATES, ELECTRICAL} <= self._received, DISCOVERY_TIMEOUT):
            missing = ", ".join(sorted({STATES, ELECTRICAL} - self._received))
            raise CommandError(f"nothing received within {DISCOVERY_TIMEOUT:g} s on {missing}")
        self.check()
        if not self._session.node.count_subscribers(VOLTAGES):
            raise CommandError(f"nobody subscribes to '{VOLTAGES}': no drive in voltage mode")

    def _wait_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        def checked() -> bool:
            self.check()
            return condition()

        return self._session.wait(checked, timeout)

    # ---- the experiment -----------------------------------------------------------------------

    def run(self, plan: VoltagePlan) -> FrictionExperiment:
        """Run the experiment; the wheels are at rest when this returns or raises."""
        assert self._robot is not None
        self.check()
        self._publisher = self._session.node.create_publisher(JointState, VOLTAGES, 1)

        def is_matched() -> bool:
            return bool(self._publisher.get_subscription_count() > 0)

        if not self._wait_until(is_matched, DISCOVERY_TIMEOUT):
            raise CommandError(f"nobody subscribes to '{VOLTAGES}'")
        experiment = FrictionExperiment(self._robot, plan, self._clock())
        self._experiment = experiment
        shown_index = experiment.level_index
        self._progress.begin("first turns")
        try:
            while experiment.phase is not ExperimentPhase.DONE:
                self.check()
                self._apply(experiment)
                if experiment.level_index != shown_index:
                    shown_index = experiment.level_index
                    self._show(experiment, plan)
                self._progress.update(experiment.fraction, experiment.phase.value)
        except ExperimentError as error:
            self._come_to_rest(experiment)
            raise CommandError(str(error)) from error
        except BaseException:
            self._come_to_rest(experiment)
            raise
        self._release(experiment)
        if experiment.restarts:
            say(f"Levels were restarted {experiment.restarts} times because of a disturbance.")
        return experiment

    @property
    def experiment(self) -> FrictionExperiment | None:
        """The experiment, once it has begun."""
        return self._experiment

    def _show(self, experiment: FrictionExperiment, plan: VoltagePlan) -> None:
        if experiment.runs:
            run = experiment.runs[-1]
            amperes = ", ".join(f"{current:.2f}" for current in np.abs(run.current).tolist())
            self._progress.end(f"{np.abs(run.speed).mean():5.1f} rad/s, {amperes} A")
        else:
            self._progress.end("the wheels turn freely")
        index, count = experiment.level_index, len(plan.levels)
        if index < count:
            self._progress.begin(f"{index + 1}/{count} {plan.levels[index]:+.1f} V")

    def _apply(self, experiment: FrictionExperiment) -> None:
        start = self._clock()
        self._publish(experiment.voltages(start))
        self._session.spin(start + PERIOD - self._clock())

    def _publish(self, voltages: Array) -> None:
        assert self._robot is not None
        message = JointState(name=list(self._robot.wheels.names), effort=voltages.tolist())
        message.header.stamp = self._session.node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _come_to_rest(self, experiment: FrictionExperiment) -> None:
        """Ramp down; neither a fault nor another signal interrupts this."""
        self._progress.abandon()
        end = self._clock() + REST_TIMEOUT
        while experiment.phase is not ExperimentPhase.DONE and self._clock() < end:
            # Drives that are stopped brake by themselves, and accept nothing but zero.
            is_stopped = self._is_emergency or bool(self._stop_reasons)
            experiment.end(self._clock(), at_once=is_stopped)
            self._apply(experiment)
        self._release(experiment)

    def _release(self, experiment: FrictionExperiment) -> None:
        """Publish zero until it is acknowledged, and leave the topic to others."""
        for _ in range(3):
            self._publish(np.zeros(len(experiment.voltages(self._clock()))))
        self._publisher.wait_for_all_acked(Duration(seconds=1))
        self._session.node.destroy_publisher(self._publisher)
        self._publisher = None
