"""The robot as the demo drives it: its client, its faults, and what is watched meanwhile."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import Bool

from omniman_ros.client.handle import MotionHandle, Outcome
from omniman_ros.client.robot import USUAL_ABILITIES, Robot
from omniman_ros.client.state import NodesRefusedError
from omniman_ros.console.errors import CommandError
from omniman_ros.console.formatting import pose_text
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import DISCOVERY_TIMEOUT, PeriodicTicks, Session
from omniman_ros.core.arrays import Array
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.perception import Perception, record_perception
from omniman_ros.demo.recorder import Recorder
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.processes.robot_setup import WORLD_DRIVE

FAULTY_NODE = {
    "simulated": "simulated_drive",
    "can": "simulated_can_drives",
    WORLD_DRIVE: "simulated_world",
}  #: Node that simulates faults of the motors, by kind of drive
PERIOD = 0.02  #: Period at which the demo changes twists and checks the progress [s]
PAUSE = 0.7  #: Time in which the platform brakes at the end of a twist [s]
AGREEMENT_TIME = 0.1  #: Time in which a change of the source that drives reaches all nodes [s]
IDLE_TIMEOUT = 5.0  #: Time after a motion within which no source drives the platform any more [s]
SERVICE_TIMEOUT = 5.0  #: Time within which a service must answer [s]
RESET_TIMEOUT = 10.0  #: Time for the reset of all nodes, in which the arm releases its brakes [s]


class DemoDriver:
    """Moves a robot, shows the progress, and ends the demo on a stop.

    Args:
        poll: Called many times per second; raises an exception to end the demo early.
        drive: Kind of drive: "simulated", "can" for simulated drives on a CAN bus, or "world" for
            those in a physics world, which also tells contacts.

    Attributes:
        robot: Client of the robot. While it waits, the robot is watched, too.
    """

    def __init__(
        self,
        session: Session,
        progress: Progress,
        poll: Callable[[], None],
        drive: str = "simulated",
        has_arm: bool = True,
    ) -> None:
        self._session, self._poll, node = session, poll, session.node
        self.robot = Robot(node=node, serve=self._serve)
        self.recorder = Recorder(node, contacts=drive == WORLD_DRIVE)
        self.progress = progress
        self.has_arm = has_arm
        self.expects_stop = False  #: Whether nodes are meant to be stopped at the moment
        self._emergency_stop = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._faults = node.create_client(SetParameters, f"{FAULTY_NODE[drive]}/set_parameters")
        self._end: BaseException | None = None
        self._last_check = time.monotonic()

    @property
    def now(self) -> float:
        """ROS time [s]."""
        return float(self._session.node.get_clock().now().nanoseconds * 1e-9)

    @property
    def arm_angles(self) -> Array:
        """Last measured joint angles (6,) [rad]."""
        return np.array(list(self.robot.joints.value.values()))

    @property
    def note(self) -> str:
        """Note beside the progress: the pose of the platform."""
        return pose_text(self.robot.pose.value)

    def wait_until_ready(self) -> None:
        """Wait until the robot can do all that the demo asks, and all that is measured is there.

        Raises:
            RobotTimeoutError: The robot is not ready after `DISCOVERY_TIMEOUT`.
            CommandError: A topic is still missing after `DISCOVERY_TIMEOUT`.
        """
        self.progress.begin("starting")
        start = time.monotonic()
        needs = (*USUAL_ABILITIES, *(("arm", "tool") if self.has_arm else ()))
        self.robot.wait_until_ready(DISCOVERY_TIMEOUT, needs)
        if not self.wait(lambda: not self.recorder.missing_topics, DISCOVERY_TIMEOUT):
            missing = ", ".join(self.recorder.missing_topics)
            raise CommandError(f"not ready within {DISCOVERY_TIMEOUT:g} s: {missing}")
        self.progress.end(f"all nodes connected after {time.monotonic() - start:.1f} s")

    def record_perception(self) -> AbstractContextManager[Perception]:
        """Record what scanner, tracker and world tell within a `with` block."""
        return record_perception(self._session.node)

    # ---- time, in which the robot is watched ----------------------------------------------------

    def restart_stall_watch(self) -> None:
        """Restart the measurement of the longest time for which this process was not served."""
        self._last_check, self.recorder.recording.stall = time.monotonic(), 0.0

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve ROS and watch the robot until a condition holds; return whether it did in time.

        Raises:
            CommandError: A node stopped, or a process ended.
        """

        def watch() -> bool:
            self._check()
            return condition()

        return self._session.wait(watch, timeout)

    def pause(self, duration: float) -> None:
        """Serve ROS and watch the robot for some time [s]."""
        self.wait(lambda: False, duration)

    def ticks(self, duration: float, period: float = PERIOD) -> PeriodicTicks:
        """Return an iterator over the elapsed time [s] that serves ROS and watches the robot."""
        return PeriodicTicks(self._session, duration, period, self._check)

    def _serve(self, seconds: float) -> None:
        self._session.spin(min(seconds, PERIOD))
        self._check()

    def _check(self) -> None:
        """Measure the time since the last check; raise an error if a node or process has ended.

        The error is raised again by each further check, so that nothing waits for such a robot.
        """
        now = time.monotonic()
        recording = self.recorder.recording
        recording.stall = max(recording.stall, now - self._last_check)
        self._last_check = now
        if self._end is not None:
            raise self._end
        try:
            self._poll()
            if not self.robot.is_open:
                return  # the demo has ended, and waits until the robot stands
            stopped = self.robot.stop_reason
            if stopped.is_known and stopped.value and not self.expects_stop:
                text = f"the robot stopped: {stopped.value}{recording.stall_note}"
                raise CommandError(text)
        except BaseException as error:
            self._end = error
            raise

    # ---- motions --------------------------------------------------------------------------------

    def arrive(
        self,
        name: str,
        motion: MotionHandle,
        timeout: float,
        on_tick: Callable[[], None] = lambda: None,
    ) -> Interval:
        """Wait until a motion that was just sent has arrived; return the interval until then.

        Args:
            timeout: Longest time that it may take [s].
            on_tick: Called every `PERIOD` while the robot is moving.

        Raises:
            CommandError: The motion ended in another way, or not in time.
        """
        self.progress.begin(name)
        start = self.now
        for _ in self.ticks(timeout):
            self.progress.update(motion.feedback.progress or 0.0, self.note)
            on_tick()
            if motion.outcome is not None:
                break
        if motion.outcome is not Outcome.ARRIVED:
            last = motion.feedback
            raise CommandError(
                f"{name} did not reach its end, only {last.progress or 0.0:.0%}: {last.state}"
                f"{f', {last.reason}' if last.reason else ''}{self.recorder.recording.stall_note}"
            )
        interval = Interval(name, start, self.now)
        self.rest()
        self.progress.end(self.note)
        return interval

    def rest(self) -> None:
        """Wait until all nodes know that no source drives the platform.

        Raises:
            CommandError: A source still drives it after `IDLE_TIMEOUT`.
        """
        if not self.wait(lambda: self.robot.active_source.value == "none", IDLE_TIMEOUT):
            source = self.robot.active_source.value
            raise CommandError(f"'{source}' still drives the platform, expected none")
        self.pause(AGREEMENT_TIME)

    # ---- stops and faults -----------------------------------------------------------------------

    def press_emergency_stop(self, *, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._emergency_stop.publish(Bool(data=pressed))

    def reset(self) -> None:
        """Reset all nodes until they grant it: a wheel may still be turning.

        Raises:
            CommandError: A node refused for too long, or is still stopped.
        """
        refusal = ""
        for _ in self.ticks(RESET_TIMEOUT, PAUSE):
            try:
                self.robot.reset()
            except NodesRefusedError as error:
                refusal = str(error)
                continue
            if self.wait(lambda: not self.robot.stop_reason.value, RESET_TIMEOUT):
                return
            refusal = f"the reset failed: {self.robot.stop_reason.value}"
        raise CommandError(refusal)

    def disable_motors(self, wheels: list[str]) -> None:
        """Switch the torque of some motors off, and of all others on.

        Raises:
            CommandError: The simulation did not answer in time.
        """
        value = ParameterValue(
            type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=wheels
        )
        request = SetParameters.Request(
            parameters=[ParameterMessage(name="faults.dead_motor", value=value)]
        )
        if not self.wait(self._faults.call_async(request).done, SERVICE_TIMEOUT):
            raise CommandError(f"{self._faults.srv_name} does not answer")
