"""A controller whose joints are in a world, both in one process and on one time."""

import numpy as np

from omniman_ros.simulation.arm_link.direct_link import DirectLink
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.program_host import ProgramHost
from omniman_ros.simulation.ur.world_arm import WorldArm
from test.simulation.ur.controller_rig import NoNetwork, Script
from test.simulation.world.support import STEP

CYCLE_STEPS = round(CYCLE / STEP)  #: Steps of the world in a cycle of the controller


class TestedLink(DirectLink):
    """A link that the test may cut.

    Attributes:
        is_refused: Whether a new connection is refused.
        sent: Number of setpoints.
    """

    def __init__(self, servo):
        super().__init__(servo)
        self._servo = servo
        self.is_refused, self.sent = False, 0

    def open(self):
        return not self.is_refused and super().open()

    def send(self, setpoint):
        self.sent += 1
        super().send(setpoint)

    def wait(self, timeout):
        raise AssertionError("the world has answered everything that was due")

    def cut(self):
        """Lose the connection, which the world notices as well."""
        self.close("cut")
        self._servo.abandon()


class WorldRig:
    """Controller and world, cycle by cycle.

    Attributes:
        bench: The world, with its drives.
        controller: The controller.
        link: The link between them.
        track: Per cycle: angles, speeds and torques that the controller measures.
    """

    def __init__(self, bench, payload=2.0, **parameters):
        self.bench, self.world = bench, bench.world
        self.link = TestedLink(self.world.arm)
        values = UrArmParameters(payload=payload, **parameters)
        arm = WorldArm(values, self.link, is_lockstep=True)
        self.scripts = {}
        self.controller = Cb3Controller(values, arm, self._launch)
        self.time, self.track, self.loads = bench.now, [], []
        self.during = lambda: None
        for _ in range(3):
            self.cycle()

    def _launch(self, text, controller):
        return Script(self.scripts[text], ProgramHost(controller, NoNetwork()))

    def play(self, each):
        self.scripts["test"] = each
        assert self.controller.start("test")

    def movej(self, q, a, v):
        """Start a program that moves to angles."""
        running = []

        def each(host, k):
            if not running:
                running.append(host.movej(tuple(q), a, v, 0.0, 0.0))

        self.play(each)

    def cycle(self):
        self.controller.arm.measure(self.time)
        self.controller.cycle(self.time)
        arm = self.controller.arm
        self.track.append((arm.q, arm.qd, arm.torque, arm.unexpected_torque, arm.lost_motion))
        for _ in range(CYCLE_STEPS):
            self.during()
            self.bench.wait(STEP)
            self.loads.append(self.world.wheel_loads)
        self.time += CYCLE

    def run(self, seconds):
        for _ in range(round(seconds / CYCLE)):
            self.cycle()

    def column(self, k):
        return np.array([row[k] for row in self.track])
