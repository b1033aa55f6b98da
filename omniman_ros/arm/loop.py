"""The streaming process: a cycle of 8 ms on absolute deadlines, alone with its sockets.

It is a process of its own because a thread that shares Python with anything busy comes late, now
and then by many cycles. It ends by itself, with the arm brought to rest, when its node is gone.
"""

import gc
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from omniman_ros.arm.channel import Channel, ChannelError
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.link import ArmLink
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.report import ArmReport, Phase, Timing
from omniman_ros.arm.sockets import LinkError
from omniman_ros.arm.streamer import ArmStreamer
from omniman_ros.core.arm_parameters import ArmParameters

LATEST_REPORT = 0.04
"""Longest time between two reports [s]."""
TIMED = 25
"""Setpoints whose punctuality is told at once."""
LEAVING = 3.0
"""How long the arm may take to come to rest when the node is gone [s]."""
SILENT = 0.5
"""Silence of the node after which the arm is brought to rest: nobody could stop it [s]."""
TIMELESS = 10.0
"""A cycle that is later than this is no cycle: the machine slept [s]."""


@dataclass(frozen=True)
class Order:
    """What the node asks for.

    Attributes:
        do: Name of a method of :class:`StreamLoop`, without its `do_`.
        arguments: For it.
    """

    do: str
    arguments: tuple[Any, ...] = ()


class StreamLoop:
    """Serves connections, node and clock until the node ends it or is gone.

    Args:
        channel: To the node.
        link: The connections.
        arm, ur: Parameters.
        clock: Gives the time, s, steady; that of the node.
    """

    def __init__(
        self, channel: Channel, link: ArmLink, arm: ArmParameters, ur: UrParameters,
        clock: Callable[[], float],
    ) -> None:  # fmt: skip
        self._channel, self._link, self._clock = channel, link, clock
        self._streamer = ArmStreamer(link, arm, ur)
        self._due = clock()
        self._running = True
        self._resets = 0
        self._reported = -LATEST_REPORT
        self._said: tuple[object, ...] = ()
        self._sent = 0.0
        self._heard = clock()
        self._intervals: deque[float] = deque(maxlen=10 * TIMED)

    def run(self) -> None:
        """Go on until the end; then bring the arm to rest."""
        while self._running:
            self.cycle()
        self._streamer.finish()
        end = self._clock() + LEAVING
        while self._streamer.phase is not Phase.IDLE and self._clock() < end:
            self.cycle()
        self._link.close()

    def cycle(self) -> None:
        """Serve everything until the next setpoint is due, then send it."""
        self._due += PERIOD
        if self._clock() - self._due > TIMELESS:
            self._streamer.tick(self._due, self._clock())  # which is told how late it is
            self._due = self._clock()
        while True:
            node = [self._channel.fileno()] if self._running else []
            heard = self._link.wait(self._due, node)
            if heard:
                self._listen()
            now = self._clock()
            samples = self._link.take_samples()
            self._streamer.watch(samples, now)
            self._miss_node(now)
            self._report(samples, now)
            if now >= self._due:
                break
        self._link.tick(now)
        before = self._streamer.phase
        self._streamer.tick(self._due, now)
        self._time(before)

    def _time(self, before: Phase) -> None:
        now = self._clock()
        if before is Phase.STREAMING is self._streamer.phase:
            if self._sent:
                self._intervals.append(now - self._sent)
            self._sent = now
        else:
            self._sent = 0.0

    def _miss_node(self, now: float) -> None:
        """Brake when the node hangs: it hears no stop."""
        if now - self._heard > SILENT:
            self._streamer.pause(f"the node said nothing for {SILENT:g} s")

    def _listen(self) -> None:
        self._heard = self._clock()
        try:
            for order in self._channel.receive():
                getattr(self, f"do_{order.do}")(*order.arguments)
        except ChannelError:
            self._running = False

    # ---- orders ---------------------------------------------------------------------------------

    def do_preview(self, times: Any, positions: Any, velocities: Any, accelerations: Any) -> None:
        """Follow a preview; the arrays are those of :class:`JointPreview`, checked by the node."""
        preview = JointPreview(times, positions, velocities, accelerations)
        self._streamer.preview(preview, self._clock())

    def do_start(self) -> None:
        """Bring the program up."""
        self._streamer.start(self._clock())

    def do_live(self) -> None:
        """Nothing: the node lives."""

    def do_resume(self) -> None:
        """Be in the place of a process that has ended."""
        self._streamer.resume()

    def do_finish(self) -> None:
        """Bring the arm to rest and end the program."""
        self._streamer.finish()

    def do_stop(self, reason: str) -> None:
        """Stop for good."""
        self._streamer.stop(reason)

    def do_hold(self, held: bool) -> None:
        """Hold the arm, or let it go on."""
        self._streamer.hold(held)

    def do_reset(self, number: int) -> None:
        """Clear the stop."""
        self._resets = number
        self._streamer.reset(self._clock())

    def do_configure(self, arm: ArmParameters, ur: UrParameters) -> None:
        """Take over parameters."""
        self._streamer.configure(arm, ur)

    # ---- reports --------------------------------------------------------------------------------

    def _report(self, samples: list[Any], now: float) -> None:
        streamer = self._streamer
        state = (
            streamer.phase, self._link.connected, streamer.trouble, streamer.stop_reason,
            streamer.failure, self._resets, streamer.at_rest,
        )  # fmt: skip
        refusals = streamer.take_refusals()
        news = samples or refusals or state != self._said
        if not news and now - self._reported < LATEST_REPORT:
            return
        self._said, self._reported = state, now
        phase, connected, trouble, stop_reason, failure, resets, at_rest = state
        report = ArmReport(
            tuple(samples), phase, connected, trouble, stop_reason, failure, resets, at_rest,
            refusals, tuple(self._link.take_texts()),
            (*self._link.counts.items(), *self._link.calls.items()), self._timing(),
        )  # fmt: skip
        try:
            if self._running:
                self._channel.send(report)
        except ChannelError:
            self._running = False

    def _timing(self) -> Timing | None:
        if len(self._intervals) < TIMED:
            return None
        timing = Timing(tuple(self._intervals), tuple(self._streamer.ages))
        self._intervals.clear()
        self._streamer.ages.clear()
        return timing


def be_punctual(priority: int) -> str:
    """Ask the kernel to run this process before others; return why it does not, or nothing.

    Args:
        priority: Of SCHED_FIFO, 1 to 99; 0: none is asked for.
    """
    gc.collect()
    gc.freeze()
    gc.disable()  # a cycle makes no circles of objects
    if not priority:
        return "ur.priority is 0"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return f"not permitted: {error.strerror}"
    return ""


def _first(channel: Channel) -> Any:
    """Wait for the first message, which comes alone."""
    messages: list[Any] = []
    while not messages:
        messages = channel.wait_and_receive()
    return messages[0]


def main() -> int:
    """Run as the process: `python -m omniman_ros.arm.loop FD`, FD the end of the node's pair."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the node ends this process
    channel = Channel(socket.socket(fileno=int(sys.argv[1])))
    arm, ur = _first(channel)
    try:
        link = ArmLink(ur, time.monotonic)
    except LinkError as error:
        channel.send(error)
        return 1
    channel.send(be_punctual(ur.priority))
    StreamLoop(channel, link, arm, ur, time.monotonic).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
