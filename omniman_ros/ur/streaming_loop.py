"""Main loop of the streaming process: cycles of 8 ms on absolute deadlines.

It is a process of its own because a thread that shares a Python interpreter with busy threads is
occasionally late by many cycles. It ends by itself when its node has ended, and brings the arm to
rest first.
"""

import gc
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.controller_link import ControllerLink
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.process_channel import ProcessChannel, ProcessChannelError
from omniman_ros.ur.sockets import LinkError
from omniman_ros.ur.streaming_messages import (
    SendTiming,
    StreamingCommand,
    StreamingPhase,
    StreamingReport,
)
from omniman_ros.ur.streaming_supervisor import StreamingSupervisor

REPORT_PERIOD = 0.04  #: Longest time between two reports [s]
TIMING_COUNT = 25  #: Number of send intervals that are reported together
FINISH_TIMEOUT = 3.0  #: How long the arm may take to come to rest when the node has ended [s]
#: Time without a message of the node after which the arm is brought to rest [s].
#: A node that hangs could not stop it.
NODE_TIMEOUT = 0.5
#: Time that a `GivenClock` adds to what it is given [s], so that rounding delays no due cycle
ROUNDING = 1e-6
#: Delay of a cycle from which on the machine counts as having been suspended [s]
SUSPEND_TIME = 10.0


class GivenClock:
    """Clock that shows the time it was last given, for simulated time."""

    def __init__(self, now: float) -> None:
        self._now = now

    def __call__(self) -> float:
        """Return the time [s]."""
        return self._now

    def set(self, now: float) -> None:
        """Set the time [s]."""
        self._now = now + ROUNDING


class StreamingLoop:
    """Serves the connections, the node and the clock until the node ends the loop or has ended.

    Args:
        clock: Returns the monotonic time [s]; the node uses the same clock. A `GivenClock` is set
            by commands of the node.
    """

    def __init__(
        self,
        channel: ProcessChannel,
        link: ControllerLink,
        arm: ArmParameters,
        ur: UrParameters,
        clock: Callable[[], float],
    ) -> None:
        self._channel, self._link, self._clock = channel, link, clock
        self._supervisor = StreamingSupervisor(link, arm, ur)
        self._due = clock()
        self._running = True
        self._resets = 0
        self._report_time = -REPORT_PERIOD
        self._sent_until = self._reported_until = self._due
        self._reported_state: tuple[object, ...] = ()
        self._send_time = 0.0
        self._node_time = clock()
        self._intervals: deque[float] = deque(maxlen=10 * TIMING_COUNT)
        supervisor = self._supervisor
        self._handlers: dict[StreamingCommand, Callable[..., None]] = {
            StreamingCommand.PREVIEW: self._follow,
            StreamingCommand.START: lambda: supervisor.start(self._clock()),
            StreamingCommand.KEEP_ALIVE: lambda: None,
            StreamingCommand.RESUME: supervisor.resume,
            StreamingCommand.FINISH: supervisor.finish,
            StreamingCommand.STOP: supervisor.stop,
            StreamingCommand.HOLD: supervisor.hold,
            StreamingCommand.LIMIT: supervisor.limit_speed,
            StreamingCommand.RESET: self._reset,
            StreamingCommand.CONFIGURE: supervisor.configure,
        }
        self._is_simulated = isinstance(clock, GivenClock)
        if isinstance(clock, GivenClock):
            self._handlers[StreamingCommand.TIME] = partial(self._pass_time, clock)

    def run(self) -> None:
        """Run cycles until the node ends the loop; then bring the arm to rest and close."""
        while self._running:
            self.cycle()
        if self._is_simulated:  # without a clock, the timeout of the program stops the arm
            self._link.close()
            return
        self._supervisor.finish()
        end = self._clock() + FINISH_TIMEOUT
        while self._supervisor.phase is not StreamingPhase.IDLE and self._clock() < end:
            self.cycle()
        self._link.close()

    def cycle(self) -> None:
        """Serve the connections and the node until the next setpoint is due, then send it."""
        self._due += PERIOD
        if self._clock() - self._due > SUSPEND_TIME:
            self._supervisor.tick(self._due, self._clock())  # stops, because it is too late
            self._due = self._clock()
        while True:
            node = [self._channel.fileno()] if self._running else []
            if self._link.wait(self._due, node):
                self._receive()
            if self._is_simulated and not self._running:
                return
            now = self._clock()
            samples = self._link.take_samples()
            self._supervisor.check(samples, now)
            self._check_node(now)
            self._report(samples, now)
            if now >= self._due:
                break
        self._link.tick(now)
        phase_before = self._supervisor.phase
        self._supervisor.tick(self._due, now)
        self._measure_interval(phase_before)
        self._sent_until = self._due + PERIOD
        if self._is_simulated:
            self._report([], now)

    def _measure_interval(self, phase_before: StreamingPhase) -> None:
        now = self._clock()
        if phase_before is StreamingPhase.STREAMING is self._supervisor.phase:
            if self._send_time:
                self._intervals.append(now - self._send_time)
            self._send_time = now
        else:
            self._send_time = 0.0

    def _check_node(self, now: float) -> None:
        """Bring the arm to rest if the node hangs, as it could not stop the arm."""
        if now - self._node_time > NODE_TIMEOUT:
            self._supervisor.pause(f"the node sent nothing for {NODE_TIMEOUT:g} s")

    def _receive(self) -> None:
        self._node_time = self._clock()
        try:
            for message in self._channel.receive():
                self._handlers[message.command](*message.arguments)
        except ProcessChannelError:
            self._running = False

    def _follow(self, times: Any, positions: Any, velocities: Any, accelerations: Any) -> None:
        """Follow a preview; the arrays are those of :class:`JointPreview`, checked by the node."""
        preview = JointPreview(times, positions, velocities, accelerations)
        self._supervisor.follow(preview, self._clock())

    def _pass_time(self, clock: GivenClock, now: float) -> None:
        """Let simulated time pass; where it goes back, end the process, which latches a stop."""
        if now < clock() - 2.0 * ROUNDING:
            self._channel.send(LinkError("simulated time has begun anew"))
            self._running = False
        clock.set(now)

    def _reset(self, number: int) -> None:
        self._resets = number
        self._supervisor.reset(self._clock())

    def _report(self, samples: list[ArmSample], now: float) -> None:
        """Send a report if anything has changed, or if the last one is too old."""
        supervisor = self._supervisor
        report = StreamingReport(
            samples=tuple(samples),
            phase=supervisor.phase,
            connected=self._link.connected,
            blocking_reason=supervisor.blocking_reason,
            stop_reason=supervisor.stop_reason,
            failure=supervisor.failure,
            resets=self._resets,
            at_rest=supervisor.at_rest,
            sent_until=self._sent_until,
            refusals=supervisor.take_refusals(),
        )
        state = (
            report.phase,
            report.connected,
            report.blocking_reason,
            report.stop_reason,
            report.failure,
            report.resets,
            report.at_rest,
        )
        has_news = bool(samples or report.refusals) or state != self._reported_state
        has_news |= self._is_simulated and report.sent_until > self._reported_until
        if not has_news and now - self._report_time < REPORT_PERIOD:
            return
        self._reported_state, self._report_time = state, now
        self._reported_until = report.sent_until
        report = replace(
            report,
            texts=tuple(self._link.take_texts()),
            counts=(*self._link.counts.items(), *self._link.refused_connections.items()),
            timing=self._take_timing(),
        )
        try:
            if self._running:
                self._channel.send(report)
        except ProcessChannelError:
            self._running = False

    def _take_timing(self) -> SendTiming | None:
        """Return the collected intervals, or None while they are too few."""
        if len(self._intervals) < TIMING_COUNT:
            return None
        timing = SendTiming(tuple(self._intervals), tuple(self._supervisor.ages))
        self._intervals.clear()
        self._supervisor.ages.clear()
        return timing


def make_punctual(priority: int) -> str:
    """Request SCHED_FIFO (1 to 99; 0: no) without garbage collection; return why not, or ""."""
    gc.collect()
    gc.freeze()
    gc.disable()  # a cycle of the loop creates no reference cycles
    if not priority:
        return "ur.priority is 0"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return f"not permitted: {error.strerror}"
    return ""


def _wait_for_first(channel: ProcessChannel) -> Any:
    """Wait for the first message and return it; no other message is sent with it."""
    messages: list[Any] = []
    while not messages:
        messages = channel.wait_and_receive()
    return messages[0]


def main() -> int:
    """Run as `python -m omniman_ros.ur.streaming_loop FD`; FD is one end of the socket pair."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the node ends this process
    channel = ProcessChannel(socket.socket(fileno=int(sys.argv[1])))
    arm, ur, simulated_time = _wait_for_first(channel)
    clock = time.monotonic if simulated_time is None else GivenClock(simulated_time)
    try:
        link = ControllerLink(ur, clock)
    except LinkError as error:
        channel.send(error)
        return 1
    channel.send(make_punctual(ur.priority))
    StreamingLoop(channel, link, arm, ur, clock).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
