"""A robot of stepped nodes in this process, for commands that run as processes beside it.

Its time never runs ahead of real time, which the commands live in; on a busy machine it falls
behind, and nothing that the robot does depends on that.
"""

import time

from test.nodes.harness import World
from test.running import PATIENCE, Running, command, environment

STEP = 0.02  #: Time by which the nodes are advanced at once [s]


class SteppedRobot:
    """Runs the nodes of a world while a test waits; a session, to those who expect one.

    Attributes:
        world: The nodes and their probe.
        node: The probe.
    """

    def __init__(self, world: World) -> None:
        self.world, self.node = world, world.probe
        world.executor.has_clients_elsewhere = True
        self._lead = world.time - time.monotonic()

    def spin(self, seconds: float) -> None:
        """Run the nodes for a real time [s]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._step()

    def wait(self, condition, timeout: float = PATIENCE) -> bool:
        """Run the nodes until a condition holds; return whether it does before a real time [s]."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self._step()
        return True

    def _step(self) -> None:
        self.world.run(STEP)
        ahead = self.world.time - time.monotonic() - self._lead
        if ahead > 0.0:
            time.sleep(ahead)
        else:
            self._lead += ahead

    def start(self, *arguments: str) -> Running:
        """Start a command of `omniman` in the robot's domain."""
        return Running(command(*arguments), environment(self.world.domain))

    def finish(self, running: Running) -> int:
        """Run the nodes until a command ends, and return its exit code."""
        assert self.wait(lambda: running.process.poll() is not None), running.output
        return running.finish()
