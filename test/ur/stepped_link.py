"""A link to the simulated controller without ports and sockets, on time that its user gives."""

from collections import deque

from omniman_ros.simulation.ur.arm import CYCLE, SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.controller_server import launcher
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.sockets import CLOSED


class Pipe:
    """The program's connection: what this host sends arrives at once."""

    def __init__(self):
        self.state, self.data = ProgramState.NONE, b""

    def open(self, host, port, name):
        if self.state is ProgramState.STARTING:
            self.state, self.data = ProgramState.RUNNING, b""
        return True  # a connection that is not awaited is closed only then

    def close(self, name):
        if self.state is ProgramState.RUNNING:
            self.state = ProgramState.LOST

    def take(self, name, count):
        if self.state is not ProgramState.RUNNING:
            return None
        if len(self.data) < count:
            return b""
        taken, self.data = self.data[:count], self.data[count:]
        return taken


class SteppedLink:
    """Stands in for a `ControllerLink`; the controller runs the program of this package.

    Args:
        now: Time of the beginning [s].
        make_body: Makes the joints from their parameters.
    """

    def __init__(self, now, make_body=SimulatedArm, **arm):
        self.now = now
        self.pipe = Pipe()
        parameters = UrArmParameters(**arm)
        self.controller = Cb3Controller(parameters, make_body(parameters), launcher(self.pipe))
        self.parameters = None
        self.address = ("10.0.0.2", 50001)
        self.blocking_reason, self.program_loss_reason = "", CLOSED
        self.counts, self.refused_connections = {}, {}
        self.sample = None
        self._samples = deque(maxlen=250)

    def cycle_controller(self):
        """Run one cycle of the controller, which then sends a sample."""
        self.now += CYCLE
        controller = self.controller
        controller.arm.measure(self.now)
        controller.cycle(self.now)
        if self.blocking_reason:
            return
        self.sample = ArmSample(
            at=self.now,
            timestamp=controller.timestamp,
            position=tuple(controller.arm.q.tolist()),
            velocity=tuple(controller.arm.qd.tolist()),
            target=tuple(controller.target.q.tolist()),
            current=(0.0,) * 6,
            robot_mode=int(controller.robot_mode),
            safety_mode=int(controller.safety_mode),
            runtime_state=int(controller.runtime),
            speed_scaling=controller.pace,
            read=int(controller.output("output_int_register_24")),
        )
        self._samples.append(self.sample)

    @property
    def connected(self):
        return not self.blocking_reason

    def take_samples(self):
        samples = tuple(self._samples)
        self._samples.clear()
        return samples

    def take_texts(self):
        return []

    @property
    def program(self):
        return self.pipe.state

    def start_program(self, text, now):
        self.pipe.state = ProgramState.STARTING
        assert self.controller.start(text)

    def send(self, data):
        self.pipe.data += data
        return self.pipe.state is ProgramState.RUNNING

    def end_program(self):
        self.pipe.state = ProgramState.NONE
