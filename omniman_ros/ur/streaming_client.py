"""Client of the streaming process in its node: start, commands, reports, detection of hangs."""

import math
from collections.abc import Callable
from typing import Any

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.dashboard_client import unlock_for_reset
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.streaming_messages import StreamingCommand, StreamingPhase, StreamingReport
from omniman_ros.ur.streaming_process import StreamingProcess

#: Starts a streaming process; the arguments are those of :class:`StreamingProcess`
StartProcess = Callable[..., StreamingProcess]
#: Time without a report after which the streaming process counts as hanging [s]
HANG_TIMEOUT = 0.5
#: Longest time between two messages to the process, which show that the node runs [s]
KEEP_ALIVE_PERIOD = 0.1
#: How long the controller may take to report that its protective stop is unlocked [s]
UNLOCK_TIMEOUT = 1.0
FINISH_TIMEOUT = 5.0  #: How long the arm may take to come to rest and its program to end [s]


class StreamingClient:
    """Starts and ends streaming processes, and exchanges messages with the one that runs.

    Args:
        wake: Called from another thread when a report has arrived.
        receive: Calls :meth:`take` and handles the reports; used while waiting.

    Attributes:
        resets: Number of resets that were sent to this process; an older report has a lower one.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        wake: Callable[[], None],
        receive: Callable[[], None],
        start_process: StartProcess = StreamingProcess,
    ) -> None:
        self._clock, self._wake, self._receive = clock, wake, receive
        self._start_process = start_process
        self.process: StreamingProcess | None = None
        self.resets = 0
        self._report_time = math.inf
        self._sent_stop = (False, "")

    def open(self, arm: ArmParameters, ur: UrParameters) -> StreamingProcess:
        """Start a process, and wait for the controller's data up to a timeout."""
        process = self.process = self._start_process(arm, ur, self._wake)
        self._report_time, self.resets, self._sent_stop = self._clock(), 0, (False, "")
        self.wait_for(lambda report: report.connected, ur.connect_timeout + 1.0)
        return process

    def replace(self, arm: ArmParameters, ur: UrParameters) -> None:
        """Replace a process that has ended or hangs; the new one is stopped until a reset."""
        self.close()
        self.open(arm, ur)
        self.send(StreamingCommand.RESUME)

    def close(self) -> None:
        """End the process if there is one; it brings the arm to rest unless it hangs."""
        if self.process is not None:
            self.process.close(kill=bool(self.hang_reason))
        self.process = None

    @property
    def report(self) -> StreamingReport:
        """The last report, or that of an idle process while there is no process."""
        return StreamingReport() if self.process is None else self.process.report

    @property
    def failure(self) -> str:
        """Why the process has ended, or an empty string."""
        return "" if self.process is None else self.process.failure

    @property
    def hang_reason(self) -> str:
        """Why the process seems to hang, or an empty string."""
        silence = self._clock() - self._report_time
        if self.process is None or self.failure or silence <= HANG_TIMEOUT:
            return ""
        return f"the streaming process has not reported for {silence:.2f} s"

    def take(self) -> list[StreamingReport]:
        """Return the reports that have arrived since the last call, oldest first."""
        reports = [] if self.process is None else self.process.take()
        if reports:
            self._report_time = self._clock()
        return reports

    def wait_for(self, condition: Callable[[StreamingReport], bool], timeout: float) -> bool:
        """Receive reports for `timeout` [s]; return whether one met a condition."""
        end = self._clock() + timeout
        while self.process is not None:
            self._receive()
            if condition(self.report):
                return True
            remaining = end - self._clock()
            if remaining <= 0.0 or self.failure:
                break
            self.process.wait(min(remaining, 0.05))
        return False

    def start_program(self, timeout: float) -> bool:
        """Have a program started; return whether setpoints are streamed within a timeout [s]."""
        self.send(StreamingCommand.START)
        self.wait_for(lambda r: r.phase is StreamingPhase.STREAMING or bool(r.failure), timeout)
        return self.report.phase is StreamingPhase.STREAMING

    def finish_program(self) -> bool:
        """Have the arm brought to rest and the program ended; return whether that is reported."""
        if self.process is None:
            return True
        self.send(StreamingCommand.FINISH)
        return self.wait_for(lambda r: r.phase is StreamingPhase.IDLE, FINISH_TIMEOUT)

    def unlock_protective_stop(self, ur: UrParameters) -> None:
        """Have the protective stop unlocked and wait for it, or raise ResetRefusedError."""
        unlock_for_reset(ur)
        self.wait_for(lambda report: not report.blocking_reason, UNLOCK_TIMEOUT)

    def send(self, command: StreamingCommand, *arguments: Any) -> None:
        """Send a command; do nothing if there is no process."""
        if self.process is not None:
            self.process.send(command, *arguments)

    def send_stop(self, is_held: bool, reason: str) -> None:
        """Send the state of the node's latch and its reason, if any, once for each change."""
        if self.process is None or (is_held, reason) == self._sent_stop:
            return
        self._sent_stop = is_held, reason
        if reason:
            self.send(StreamingCommand.STOP, reason)
        self.send(StreamingCommand.HOLD, is_held)

    def send_reset(self) -> None:
        """Have the process clear its stop."""
        self.resets += 1
        self.send(StreamingCommand.RESET, self.resets)

    @property
    def progress(self) -> float:
        """Instant before which the process has sent all setpoints [s]."""
        is_streaming = self.report.phase is StreamingPhase.STREAMING
        return self.report.sent_until if is_streaming else self._clock()

    def pass_time(self) -> None:
        """Let simulated time pass in the process, up to now."""
        self.send(StreamingCommand.TIME, self._clock())

    def flush(self) -> None:
        """Send messages that did not fit into the buffer; to be called periodically."""
        if self.process is not None:
            self.process.flush()
