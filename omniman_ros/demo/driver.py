"""Execution of the demo's motions: sending, waiting, and watching the robot meanwhile."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from rclpy.client import Client
from std_srvs.srv import Trigger

from omniman_ros.console.errors import CommandError
from omniman_ros.console.formatting import pose_text
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import DISCOVERY_TIMEOUT, PeriodicTicks, Session
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.figures import ArmMove
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.perception import Perception, record_perception
from omniman_ros.demo.recorder import Recorder
from omniman_ros.demo.robot_interface import RobotInterface
from omniman_ros.nodes.stoppable_nodes import TriggerCalls
from omniman_ros.processes.robot_setup import WORLD_DRIVE

ARM_MOVE_TIME = 2.5  #: Duration of a measured move of the arm, within its limits [s]
PERIOD = 0.02  #: Period at which the demo sends twists and checks the progress [s]
PAUSE = 0.7  #: Shortest pause between two parts of the demo [s]
AGREEMENT_TIME = 0.1  #: Time in which a change of the source that drives reaches all nodes [s]
IDLE_TIMEOUT = 5.0  #: Time after a motion within which no source drives the platform any more [s]
SERVICE_TIMEOUT = 5.0  #: Time within which a service must answer [s]
RESET_TIMEOUT = 10.0  #: Time for the reset of all nodes, in which the arm releases its brakes [s]
SLOWEST_SPEED = 0.1  #: Mean speed below which a motion is given up [m/s]
EXTRA_TIME = 20.0  #: Time that a motion may take beyond its length at `SLOWEST_SPEED` [s]


class DemoDriver:
    """Executes motions one after the other, shows their progress, and ends the demo on a stop.

    Args:
        poll: Called many times per second; raises an exception to end the demo early.
        drive: Kind of drive: "simulated", "can" for simulated drives on a CAN bus, or "world" for
            those in a physics world, which also tells contacts.
    """

    def __init__(
        self,
        session: Session,
        progress: Progress,
        poll: Callable[[], None],
        drive: str = "simulated",
        has_arm: bool = True,
    ) -> None:
        self._session = session
        self._poll = poll
        self.robot = RobotInterface(session.node, drive)
        self.recorder = Recorder(session.node, contacts=drive == WORLD_DRIVE)
        self.progress = progress
        self.has_arm = has_arm
        self.expects_stop = False  #: Whether nodes are meant to be stopped at the moment
        self._last_check = time.monotonic()

    @property
    def now(self) -> float:
        """ROS time [s]."""
        return float(self._session.node.get_clock().now().nanoseconds * 1e-9)

    @property
    def pose(self) -> Triple:
        """Last pose of the platform in odom [m, m, rad]."""
        x, y, theta = self.recorder.recording.odom[-1][1:4]
        return x, y, theta

    @property
    def arm_angles(self) -> Array:
        """Last measured joint angles (6,) [rad]."""
        return np.array(self.recorder.recording.arm[-1][1:])

    @property
    def note(self) -> str:
        """Note beside the progress: the pose of the platform."""
        return pose_text(self.pose)

    def wait_until_ready(self) -> None:
        """Wait until all topics that the demo needs are published and subscribed to.

        Raises:
            CommandError: A topic is still missing after `DISCOVERY_TIMEOUT`.
        """
        self.progress.begin("starting")
        start = time.monotonic()
        if not self.wait(lambda: not self._missing(), DISCOVERY_TIMEOUT):
            raise CommandError(f"not ready within {DISCOVERY_TIMEOUT:g} s: {self._missing()}")
        self.progress.end(f"all nodes connected after {time.monotonic() - start:.1f} s")

    def record_perception(self) -> AbstractContextManager[Perception]:
        """Record what scanner, tracker and world tell within a `with` block."""
        return record_perception(self._session.node)

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

    def wait_until_idle(self) -> bool:
        """Wait until no source drives the platform; return whether that was within the timeout."""
        return self.wait(lambda: self.recorder.active_source == "none", IDLE_TIMEOUT)

    def rest(self) -> None:
        """Pause between two parts of the demo, at least until no source drives the platform."""
        for _ in self.ticks(PAUSE):
            pass
        self.wait_until_idle()
        self.pause(AGREEMENT_TIME)

    def _check(self) -> None:
        """Measure the time since the last check; raise an error if a node or process has ended."""
        now = time.monotonic()
        recording = self.recorder.recording
        recording.stall = max(recording.stall, now - self._last_check)
        self._last_check = now
        self._poll()
        for name, reason in self.recorder.stopped.items() if not self.expects_stop else ():
            raise CommandError(f"the robot stopped: {name} is {reason}{recording.stall_note}")

    def _missing(self) -> str:
        missing = self.recorder.missing_topics
        if self.has_arm and not self.recorder.recording.arm:
            missing.append("arm/joint_states")
        missing += [f"a subscriber of {topic}" for topic in self.robot.unconnected_topics]
        return ", ".join(missing)

    def follow(
        self,
        name: str,
        send: Callable[[], None],
        length: float,
        on_tick: Callable[[], None] = lambda: None,
    ) -> Interval:
        """Send a motion that reports its progress; return the interval until its arrival.

        Args:
            length: Path length, which determines the timeout [m].
            on_tick: Called every `PERIOD` while the robot is moving.

        Raises:
            CommandError: The motion was not accepted, or did not reach its end in time.
        """
        self.progress.begin(name)
        self.recorder.begin_motion()
        start = self.now
        send()
        for _ in self.ticks(EXTRA_TIME + length / SLOWEST_SPEED):
            self.progress.update(self.recorder.progress, self.note)
            on_tick()
            if self.recorder.has_arrived:
                break
        else:
            raise CommandError(
                f"{name} did not reach its end, only {self.recorder.progress:.0%}"
                f"{self.recorder.recording.stall_note}"
            )
        interval = Interval(name, start, self.now)
        self.rest()
        self.progress.end(self.note)
        return interval

    def move_arm(self, goal: Array) -> ArmMove:
        """Start a measured move of the arm to joint angles (6,) [rad]; do not wait for its end."""
        self.robot.send_arm_goal(goal, ARM_MOVE_TIME)
        return ArmMove(tuple(goal.tolist()), self.now)

    def halt(self) -> None:
        """Send a twist of zero."""
        self.robot.send_twist((0.0, 0.0, 0.0))

    def call(self, client: Client, request: Any) -> Any:
        """Call a service, and return its answer.

        Raises:
            CommandError: The service did not answer in time.
        """
        future = client.call_async(request)
        if not self.wait(future.done, SERVICE_TIMEOUT):
            raise CommandError(f"{client.srv_name} does not answer")
        return future.result()

    def reset(self, client: Client) -> None:
        """Call a node's reset until it is granted: a wheel may still be turning.

        Raises:
            CommandError: The service did not answer in time, or refused for too long.
        """
        for _ in self.ticks(RESET_TIMEOUT, PAUSE):
            answer = self.call(client, Trigger.Request())
            if answer.success:
                return
        raise CommandError(f"{client.srv_name} refused: {answer.message}")

    def reset_all(self) -> None:
        """Reset all nodes of the robot.

        Raises:
            CommandError: A node is still stopped.
        """
        node = self._session.node
        calls = TriggerCalls(node, "reset", node.get_namespace())
        try:
            calls.poll()
            self.wait(lambda: calls.poll() and not self.recorder.stopped, RESET_TIMEOUT)
        finally:
            calls.close()
        if self.recorder.stopped:
            refused = [answer[1] for answer in calls.answers.values() if answer and not answer[0]]
            raise CommandError(f"the reset failed: {', '.join(refused) or self.recorder.stopped}")
