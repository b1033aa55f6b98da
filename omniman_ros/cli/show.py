"""The show of the demo: twists through cmd_vel, then a figure through path/reference."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from geometry_msgs.msg import Transform, Twist, Vector3
from rclpy.duration import Duration
from rclpy.time import Time
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Figure, Pace, Sample, Triple, TwistPhase, twist_phases
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.recorder import Recorder
from omniman_ros.cli.score import DrivenFigure, DrivenTwist, excuse
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.conversions import PLATFORM_JOINT, quaternion

TWIST_PERIOD = 0.02
PREVIEW_PERIOD = 0.025
PREVIEW_POINTS = 13
PREVIEW_STEP = 0.025
"""A preview of 0.3 s every 25 ms, a point every 25 ms."""
PAUSE = 0.7
"""Rest between two parts [s]."""
LEAD = 0.3
"""Time from the first preview to the figure's start [s]."""


def pose_text(pose: Triple) -> str:
    """A pose for people; no minus sign on a zero."""
    x, y = (round(value, 2) + 0.0 for value in pose[:2])
    degrees = round(math.degrees(math.remainder(pose[2], math.tau)))
    return f"x {x:+.2f} m  y {y:+.2f} m  heading {degrees:+4d} deg"


def twist_message(twist: Triple) -> Twist:
    """A body twist or a world velocity as a message."""
    x, y, angle = twist
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=angle))


def preview_point(sample: Sample, after: Duration) -> MultiDOFJointTrajectoryPoint:
    """A sample as a point, due some time after the header's stamp."""
    x, y, theta = sample.pose
    pose = Transform(translation=Vector3(x=x, y=y), rotation=quaternion(theta))
    return MultiDOFJointTrajectoryPoint(
        transforms=[pose],
        velocities=[twist_message(sample.velocity)],
        accelerations=[twist_message(sample.acceleration)],
        time_from_start=after.to_msg(),
    )


def preview_message(figure: Figure, now: Time, start: Time) -> MultiDOFJointTrajectory:
    """The next 0.3 s of a figure that starts at `start`; it ends at rest where the figure does."""
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id = "odom"
    message.header.stamp = now.to_msg()
    since = (now - start).nanoseconds * 1e-9
    message.points = [
        preview_point(
            figure.sample(since + i * PREVIEW_STEP),
            Duration(nanoseconds=round(i * PREVIEW_STEP * 1e9)),
        )
        for i in range(PREVIEW_POINTS)
    ]
    return message


@dataclass
class Driven:
    """What was driven, for the judgement."""

    twists: list[DrivenTwist] = field(default_factory=list)
    figure: DrivenFigure | None = None


class Show:
    """Drives the robot and shows how far it is.

    Args:
        session: The ROS node.
        pace: How fast.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end the show early.
    """

    def __init__(
        self, session: Session, pace: Pace, progress: Progress, poll: Callable[[], None]
    ) -> None:
        self._session = session
        self._pace = pace
        self._progress = progress
        self._poll = poll
        self._twists = session.node.create_publisher(Twist, "cmd_vel", 1)
        self._previews = session.node.create_publisher(
            MultiDOFJointTrajectory, "path/reference", 1
        )
        self.recorder = Recorder(session.node)
        self.driven = Driven()
        self._checked = time.monotonic()

    # ---- parts ------------------------------------------------------------------------------

    def meet(self) -> None:
        """Wait until everything that is published and listened to is there.

        Raises:
            CommandError: It is not in time.
        """
        self._progress.begin("starting")
        before = time.monotonic()
        if not self._wait(lambda: not self._absent(), DISCOVERY):
            raise CommandError(f"nothing heard within {DISCOVERY:g} s of {self._absent()}")
        self._progress.end(f"nodes up and talking after {time.monotonic() - before:.1f} s")

    def drive_twists(self) -> None:
        """Drive all parts that are twists."""
        for phase in twist_phases(self._pace):
            self._drive_twist(phase)

    def follow_figure(self) -> None:
        """Follow the figure, from where the robot is, through previews."""
        self._progress.begin("follow a path")
        if not self._wait(lambda: self.recorder.active_source == "none", 5.0):
            raise CommandError(f"'{self.recorder.active_source}' still drives, expected none")
        figure = Figure(self._pose(), self._pace.figure, self._pace.ramp)
        clock = self._session.node.get_clock()
        start = clock.now() + Duration(nanoseconds=round(LEAD * 1e9))
        self.driven.figure = DrivenFigure(figure, start.nanoseconds * 1e-9)
        took_over = False
        ticks = self._ticks(LEAD + figure.duration, PREVIEW_PERIOD)
        for elapsed in ticks:
            self._previews.publish(preview_message(figure, clock.now(), start))
            self._progress.update(elapsed / (LEAD + figure.duration), self._note())
            took_over |= self.recorder.active_source == "path"
        if not took_over:
            raise CommandError("the controller did not take over path/reference")
        self._rest()
        self._progress.end(self._note())

    def _drive_twist(self, phase: TwistPhase) -> None:
        self._progress.begin(phase.name)
        start = self._session.node.get_clock().now().nanoseconds * 1e-9
        self.driven.twists.append(DrivenTwist(phase, start))
        for elapsed in self._ticks(phase.duration, TWIST_PERIOD):
            self._twists.publish(twist_message(phase.twist(elapsed)))
            self._progress.update(elapsed / phase.duration, self._note())
        for _ in self._ticks(PAUSE, TWIST_PERIOD):
            self.halt()
        self._progress.end(self._note())

    def halt(self) -> None:
        """Ask for rest."""
        self._twists.publish(Twist())

    def _rest(self) -> None:
        """Wait until the controller says that nobody drives."""
        for _ in self._ticks(PAUSE, TWIST_PERIOD):
            pass
        self._wait(lambda: self.recorder.active_source == "none", 5.0)

    # ---- helpers ----------------------------------------------------------------------------

    def _ticks(self, duration: float, period: float) -> "Ticks":
        return Ticks(self._session, duration, period, self._check)

    def _wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        def checked() -> bool:
            self._check()
            return condition()

        return self._session.wait(checked, timeout)

    def _check(self) -> None:
        """Called at least every SLICE seconds while the show goes on."""
        now = time.monotonic()
        recording = self.recorder.recording
        recording.stall = max(recording.stall, now - self._checked)
        self._checked = now
        self._poll()
        for name, why in self.recorder.stopped.items():
            raise CommandError(f"the robot stopped: {name} is {why}{excuse(recording)}")

    def _absent(self) -> str:
        unheard = [
            f"a listener to {publisher.topic_name}"
            for publisher in (self._twists, self._previews)
            if not publisher.get_subscription_count()
        ]
        return ", ".join(self.recorder.missing + unheard)

    def _pose(self) -> Triple:
        x, y, theta = self.recorder.recording.odom[-1][1:4]
        return x, y, theta

    def _note(self) -> str:
        return pose_text(self._pose())


class Ticks:
    """Iterates over the time elapsed, at a fixed period, for a duration; serves ROS meanwhile."""

    def __init__(
        self, session: Session, duration: float, period: float, check: Callable[[], None]
    ) -> None:
        self._session = session
        self._period = period
        self._check = check
        self._start = time.monotonic()
        self._end = self._start + duration
        self._next = self._start

    def __iter__(self) -> "Ticks":
        return self

    def __next__(self) -> float:
        self._session.spin(self._next - time.monotonic())
        self._check()
        now = time.monotonic()
        if now >= self._end:
            raise StopIteration
        self._next = max(self._next + self._period, now)
        return now - self._start
