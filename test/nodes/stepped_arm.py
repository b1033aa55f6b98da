"""The streaming process and the simulated controller, in step with the world of a node test."""

from dataclasses import replace

import numpy as np

from omniman_ros.simulation.ur.arm import CYCLE
from omniman_ros.simulation.ur.modes import Cb3RuntimeState
from omniman_ros.ur.process_channel import ProcessChannelError
from omniman_ros.ur.streaming_loop import StreamingLoop
from omniman_ros.ur.streaming_messages import CommandMessage, StreamingReport
from omniman_ros.ur.streaming_process import ENDED
from test.nodes.harness import START
from test.ur.stepped_link import SteppedLink

REST_SPEED = 0.01  #: Speed below which the arm counts as standing [rad/s]


class SteppedArm(SteppedLink):
    """A simulated controller, and the streaming process that a node starts for it.

    Args:
        options: Options of the link: the joints, and their parameters.

    Attributes:
        process: The streaming process that was started last; None before the first.
        start_failure: Why a streaming process ends as soon as it is started, or an empty string.
        pass_time: Called by what waits, with a time [s]; it has to call :meth:`advance`.
    """

    def __init__(self, **options):
        super().__init__(START, **options)
        self.process = None
        self.start_failure = ""
        self.pass_time = None

    def start_process(self, arm, ur, wake, clock):
        self.process = SteppedProcess(self, arm, ur, wake)
        self.process.failure = self.start_failure
        return self.process

    def advance(self, now):
        """Run the cycles of controller and streaming process that are due at a time [s]."""
        while self.now + CYCLE < now + 1e-9:
            self.cycle_controller()
            if self.process is not None:
                self.process.cycle()

    def fault(self, **changes):
        self.controller.faults = replace(self.controller.faults, **changes)

    @property
    def place(self):
        return self.controller.arm.q.copy()

    @property
    def speed(self):
        return float(np.abs(self.controller.arm.qd).max())

    def rests(self):
        return self.speed < REST_SPEED

    def plays(self):
        return self.controller.runtime is Cb3RuntimeState.PLAYING

    def is_paused(self):
        return self.controller.runtime is Cb3RuntimeState.PAUSED

    def wait(self, until, others):
        if others and self.process.has_news:
            return others
        if self.now < until:  # the process comes to its end, and the node waits for that
            self.pass_time(until - self.now)
        return []

    def tick(self, now):
        pass

    def close(self):
        self.end_program()


class SteppedProcess:
    """Stands in for a `StreamingProcess`: its loop runs in the test, one cycle at a time.

    Attributes:
        commands: Messages of the node that the loop has not yet received.
        has_ended: Whether the process has ended, or has been told to end.
        is_frozen: Whether the process stands still, as by SIGSTOP.
    """

    def __init__(self, link, arm, ur, wake):
        self.report = StreamingReport()
        self.failure = self.priority_warning = ""
        self.commands = []
        self.has_ended = self.is_frozen = False
        self._link, self._wake = link, wake
        self._reports = []
        self._due_cycles = 0
        self._loop = StreamingLoop(_Channel(self), link, arm, ur, lambda: link.now)

    def cycle(self):
        """Run the cycles that are due, unless the process is frozen."""
        self._due_cycles += 1
        while self._due_cycles and not (self.is_frozen or self.has_ended):
            self._due_cycles -= 1
            self._loop.cycle()

    @property
    def has_news(self):
        """Whether the loop finds its channel readable."""
        return bool(self.commands) or self.has_ended

    def send(self, command, *arguments):
        self.commands.append(CommandMessage(command, arguments))

    def flush(self):
        pass

    def take(self):
        if self.has_ended:
            self.failure = self.failure or ENDED
        reports, self._reports = self._reports, []
        if reports:
            self.report = reports[-1]
        return reports

    def wait(self, timeout):
        self._link.pass_time(min(timeout, CYCLE))

    def add_report(self, report):
        self._reports.append(report)
        self._wake()

    def kill(self):
        """End the process as by SIGKILL, which closes its connections."""
        self.has_ended = True
        self._link.close()
        self._wake()

    def close(self, kill=False):
        self._wake = lambda: None
        if not (self.has_ended or kill):
            self.has_ended = True
            self._loop.run()
        self._link.close()


class _Channel:
    """The loop's end of the channel to the node."""

    def __init__(self, process):
        self._process = process

    def fileno(self):
        return 0

    def send(self, report):
        self._process.add_report(report)

    def receive(self):
        commands, self._process.commands = self._process.commands, []
        if not commands and self._process.has_ended:
            raise ProcessChannelError("the node has closed the channel")
        return commands
