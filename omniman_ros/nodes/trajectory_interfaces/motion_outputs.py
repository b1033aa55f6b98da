"""Where the motions of the arm, and of the whole body, are sent."""

from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.window import Window
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext


class ArmOutput:
    """Sends motions of the arm, and notes where they lead."""

    def __init__(self, context: BodyContext) -> None:
        self._context = context
        self._last_position: Array | None = None

    def begin(self, *, from_rest: bool) -> None:
        """Note that a motion begins, from rest or in place of another one."""
        if from_rest:
            self._context.arm_feed.start_motion()
            self._context.arm_previews.covered_until = float("inf")

    def send(self, window: Window) -> None:
        """Publish a stretch of the motion under way."""
        self.send_arm(window)

    def send_arm(self, window: Window) -> None:
        """Publish a stretch (k, 6) of the arm's part of the motion."""
        self._last_position = window.positions[-1]
        self._context.arm_feed.record_reference(window.positions[0])
        self._context.arm_previews.send(window)

    def end(self) -> None:
        """Note that the motion came to rest where the last stretch ends."""
        self._context.arm_feed.rest_position = self._last_position

    def give_up(self) -> None:
        """Note that the motion was given up: it is not known where it comes to rest."""
        self._context.arm_feed.rest_position = None

    def is_covered(self, now: float) -> bool:
        """Return whether the receivers still have a reference."""
        return now <= self._context.arm_previews.covered_until


class WholeBodyOutput(ArmOutput):
    """Sends motions of all nine axes, each part to its receiver."""

    def begin(self, *, from_rest: bool) -> None:
        """Note that a motion begins; see the base class."""
        super().begin(from_rest=from_rest)
        if from_rest:
            self._context.odom.silence = 0.0
            self._context.platform_previews.covered_until = float("inf")
        self._context.stream_monitor.begin(self._context.node.now())

    def send(self, window: Window) -> None:
        """Publish a stretch (k, 9) of both parts."""
        self._context.platform_previews.send(window.columns(PLATFORM_COLUMNS))
        self._context.stream_monitor.sent(self._context.node.now())
        self.send_arm(window.columns(JOINT_COLUMNS))

    def end(self) -> None:
        """Note that the motion came to rest; see the base class."""
        super().end()
        self._context.stream_monitor.end(lost=False)

    def give_up(self) -> None:
        """Note that the motion was given up; see the base class."""
        super().give_up()
        self._context.stream_monitor.end(lost=True)

    def is_covered(self, now: float) -> bool:
        """Return whether the receivers of both parts still have a reference."""
        return super().is_covered(now) and now <= self._context.platform_previews.covered_until
