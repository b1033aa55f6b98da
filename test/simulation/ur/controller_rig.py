"""A controller without ports, run cycle by cycle, with a program written in Python."""

import numpy as np

from omniman_ros.simulation.ur.arm import CYCLE, SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.faults import UrFaultParameters
from omniman_ros.simulation.ur.program_host import ProgramHost
from omniman_ros.simulation.ur.urscript.errors import ScriptError


class Script:
    """A program that calls a function of controller and cycle number once per cycle."""

    is_secondary = False

    def __init__(self, each, host):
        self.each, self.host, self.steps, self.end_reason = each, host, 0, ""

    @property
    def running(self):
        return not self.end_reason

    def step(self):
        self.each(self.host, self.steps)
        self.steps += 1

    def stop(self, reason):
        self.end_reason = self.end_reason or reason

    def close_popups(self):
        pass


class NoNetwork:
    def __getattr__(self, name):
        raise AssertionError(f"nobody asked for {name}")


class Rig:
    def __init__(self, **parameters):
        parameters.setdefault("initial", (0.0, -1.5, 1.0, 0.0, 0.5, 0.0))
        self.scripts = {"idle": lambda host, k: None}
        values = UrArmParameters(**parameters)
        self.controller = Cb3Controller(values, SimulatedArm(values), self._launch)
        self.host = ProgramHost(self.controller, NoNetwork())
        self.start = self.controller.arm.q.copy()
        self.cycles = 0
        self.track = []

    def _launch(self, text, controller):
        if text not in self.scripts:
            raise ScriptError(1, "nonsense")
        self.script = Script(self.scripts[text], ProgramHost(controller, NoNetwork()))
        return self.script

    def play(self, each):
        self.scripts["test"] = each
        assert self.controller.start("test")

    def faults(self, **faults):
        self.controller.faults = UrFaultParameters(**faults)

    def cycle(self):
        self.cycles += 1
        self.controller.cycle(100.0 + self.cycles * CYCLE)
        self.track.append((self.controller.arm.q - self.start, self.controller.arm.qd))

    def run(self, seconds):
        for _ in range(round(seconds / CYCLE)):
            self.cycle()

    @property
    def speed(self):
        """Return the speed of the fastest joint."""
        return float(np.max(np.abs(self.controller.arm.qd)))

    @property
    def moved(self):
        """Return the displacement of joint 0."""
        return float(self.controller.arm.q[0] - self.start[0])

    def hardest(self):
        """Return the largest acceleration of any joint so far."""
        speeds = np.array([qd for _, qd in self.track])
        return float(np.max(np.abs(np.diff(speeds, axis=0)))) / CYCLE


def sweep(rig, speed=0.5):
    """Return a program that servos joint 0 at a constant speed, and its setpoints."""
    sent = []

    def each(host, k):
        if not sent or sent[-1][1]():
            q = rig.start.copy()
            q[0] += speed * CYCLE * len(sent)
            sent.append((q[0], host.servoj(tuple(q.tolist()), CYCLE, 0.03, 1000)))

    return each, sent
