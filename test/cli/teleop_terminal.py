"""`omniman teleop` in a pseudo-terminal, whose keys a test types and whose screen it reads."""

import os
import pty
import select
import subprocess
import sys
import time
from contextlib import contextmanager

from test.running import PATIENCE, command, environment

REPEAT_DELAY = 0.3  #: Time between the press of a key and its first repeat [s]
REPEAT_PERIOD = 0.03  #: Time between later repeats of a key [s]

# Makes stdin the controlling terminal, so that Ctrl-C works, and continues as the command.
IN_TERMINAL = (
    "import fcntl, os, sys, termios\n"
    "fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    "os.execv(sys.argv[1], sys.argv[1:])\n"
)


class Terminal:
    """A teleoperation with its keyboard and its screen."""

    def __init__(self, domain, *options):
        self.screen = ""
        self.file, inner = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", IN_TERMINAL, *command("teleop", *options)],
            env=environment(domain) | {"COLUMNS": "200", "TERM": "xterm"},
            stdin=inner,
            stdout=inner,
            stderr=inner,
            start_new_session=True,
        )
        os.close(inner)

    def type(self, keys):
        os.write(self.file, keys.encode())

    def read(self, timeout=0.0):
        """Read what has been written to the screen."""
        try:
            while select.select([self.file], [], [], timeout)[0]:
                self.screen += os.read(self.file, 65536).decode()
                timeout = 0.0
        except OSError:  # closed at the other end
            pass

    @property
    def line(self):
        """The latest complete status line."""
        return self.screen.split("\x1b[K")[-2].strip("\r") if "\x1b[K" in self.screen else ""

    def wait(self, session, condition, what):
        """Serve ROS and the screen until a condition holds."""

        def read():
            self.read()
            return condition()

        assert session.wait(read, PATIENCE), f"no {what}; screen:\n{self.screen[-2000:]}"

    def finish(self):
        """Wait for the end, read the rest of the screen, and return the exit code."""
        end = time.monotonic() + PATIENCE
        while self.process.poll() is None:
            assert time.monotonic() < end, f"teleop did not end; screen:\n{self.screen[-2000:]}"
            self.read(0.05)
        self.read()
        return self.process.returncode

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.file)


@contextmanager
def terminal(domain, *options):
    """Run `omniman teleop` with these options in a terminal, within a `with` block."""
    teleop = Terminal(domain, *options)
    try:
        yield teleop
    finally:
        teleop.close()


def hold(teleop, session, key, condition, seconds=PATIENCE):
    """Type a key as a keyboard repeats it, until a condition holds."""
    teleop.type(key)
    end = time.monotonic() + seconds
    delay = REPEAT_DELAY
    while not condition():
        assert time.monotonic() < end, f"holding '{key}' has no effect:\n{teleop.line}"
        session.spin(delay)
        delay = REPEAT_PERIOD
        teleop.type(key)
        teleop.read()
