"""Runs a program, one controller cycle at a time."""

from random import Random

from omniman_ros.core.errors import OmnimanError
from omniman_ros.simulated_ur.urscript.errors import Fault
from omniman_ros.simulated_ur.urscript.host import Host
from omniman_ros.simulated_ur.urscript.instructions import (
    PENDING,
    Frame,
    Function,
    Thread,
)
from omniman_ros.simulated_ur.urscript.parser import Program
from omniman_ros.simulated_ur.urscript.values import Value

MOST_INSTRUCTIONS = 100_000  # of a thread in a cycle; the longest loops of drivers need some 1,000
MOST_THREADS = 64


class Machine:
    """A program under way.

    Args:
        program: What is run.
        host: The controller that it asks and commands.
        most_instructions: What a thread may execute in a cycle; more is an endless loop.
        seed: Of the function `random`.

    Attributes:
        running: Whether the program has not ended.
        end_reason: Why it ended: "ended", "halt", "runtime error line n: ...", or what `stop` was
            told; "" while it runs.
        variables: Global variables.
        sockets: Names of those that the program opened.
        kept: Bytes of a socket that were read in part.
        popups_closed: How often the person at the pendant closed a message.
        random: Of the function `random`.
    """

    def __init__(
        self,
        program: Program,
        host: Host,
        most_instructions: int = MOST_INSTRUCTIONS,
        seed: int = 0,
    ) -> None:
        self.host = host
        self.end_reason = ""
        self.variables: dict[str, Value] = {}
        self.sockets: set[str] = set()
        self.kept: dict[str, bytearray] = {}
        self.popups_closed = 0
        self.random = Random(seed)
        self._most_instructions = most_instructions
        self._takes_no_time = program.secondary
        self._main = Thread(self, 0, Frame(program.main, self.variables))
        self._threads = {0: self._main}  # in the order in which they started
        self._last_handle = 0
        self._started = 0  # in this cycle

    @property
    def running(self) -> bool:
        """Whether the program has not ended."""
        return not self.end_reason

    def step(self) -> None:
        """Run one cycle: each thread until it gives up its time slice, the main one first.

        Threads that are started run in the same cycle, those that wait for the end of another go
        on in the cycle in which that ends.
        """
        self._started = 0
        for thread in self._threads.values():
            thread.left = self._most_instructions
        ready = list(self._threads.values())
        while ready and self.running:
            before = set(self._threads)
            # Those that gave up their time slice are out; a join may be over in a later round.
            again = [thread for thread in ready if not self._go_on(thread)]
            started = [each for each in self._threads.values() if each.handle not in before]
            if len(again) == len(ready) and not started:
                break
            ready = [thread for thread in again if thread.frame] + started

    def close_popups(self) -> None:
        """The person at the pendant closes all messages: calls that wait for it go on."""
        self.popups_closed += 1

    def stop(self, reason: str) -> None:
        """End the program and its threads, and close its sockets; nothing if it has ended."""
        if not self.running:
            return
        self.end_reason = reason
        for thread in self._threads.values():
            thread.frame = None
        self._threads.clear()
        for name in sorted(self.sockets):
            self.host.socket_close(name)
        self.sockets.clear()

    # What instructions ask for

    def start(self, function: Function) -> int:
        """Start a thread; its handle.

        Raises:
            Fault: There are too many.
        """
        self._started += 1
        if max(len(self._threads), self._started) >= MOST_THREADS:
            raise Fault(f"more than {MOST_THREADS} threads at once, or started in one cycle")
        self._last_handle += 1
        thread = Thread(self, self._last_handle, Frame(function, {}))
        thread.left = self._most_instructions
        self._threads[thread.handle] = thread
        return thread.handle

    def kill(self, handle: int) -> None:
        """End a thread; nothing if there is none, and 0 is the handle of none."""
        if handle in self._threads and handle != 0:
            self._threads.pop(handle).frame = None

    def is_alive(self, handle: int) -> bool:
        """Whether there is a thread of that handle; 0 is the handle of none."""
        return handle in self._threads and handle != 0

    # Threads

    def _go_on(self, thread: Thread) -> bool:
        """Let a thread run; whether it gave up its time slice or ended."""
        if thread.frame is None:
            return True
        try:
            if not self._is_over(thread):
                return thread.wait is not None and thread.wait.takes_time
            self._execute(thread)
        except OmnimanError as error:
            self.stop(f"runtime error line {thread.line}: {error}")
            return True
        if thread.frame is None:
            self._threads.pop(thread.handle, None)
            if thread is self._main:
                self.stop("ended")
            return True
        return thread.wait is None or thread.wait.takes_time

    def _is_over(self, thread: Thread) -> bool:
        """Whether a thread waits for nothing any more."""
        if thread.wait is not None:
            value = thread.wait.poll()
            if value is PENDING:
                return False
            thread.wait = None
            thread.stack.append(value)
        return True

    def _execute(self, thread: Thread) -> None:
        """Execute a thread's instructions until it waits or ends.

        Raises:
            Fault: One fails, or they are too many for a cycle.
        """
        left = thread.left
        while left > 0:
            left -= 1
            frame = thread.frame
            operation, argument = frame.code[frame.next]  # type: ignore[union-attr]
            frame.next += 1  # type: ignore[union-attr]
            if operation(thread, argument):
                thread.left = left
                if self._takes_no_time and thread.wait is not None and thread.wait.takes_time:
                    raise Fault("a secondary program cannot take time")
                return
        raise Fault("infinite loop")
