"""Node `simulated_ur`: simulates a UR5 with a CB3 controller on TCP."""

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_ur_parameters import SimulatedUrParameters
from omniman_ros.simulation.ur.controller_clock import SimulatedTime
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.faults import active_faults


class SimulatedUrNode(OmnimanNode):
    """Runs a :class:`ControllerServer`, and publishes the true motion of its arm.

    Like a real controller, it is commanded over TCP only, not by topics. Its joints may be in
    `simulated_world`.
    """

    lookahead = 0.01

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_ur", **options)
        self.settings = ParameterSet(self, SimulatedUrParameters)
        p = self.settings.value
        self._simulated_time = SimulatedTime() if self.is_simulated else None
        self.server = ControllerServer(p.simulated_arm, p.ports, self._simulated_time)
        self.controller = self.server.controller
        self._slider = self.controller.slider
        self._configure(p)
        self.settings.on_change(self._configure)
        self._truth = self.create_publisher(JointState, "ground_truth/arm_joint_states", 10)
        self._truth_msg = JointState(name=list(p.arm.joints))
        self._ending = False
        numbers = ", ".join(f"{name} {k}" for name, k in self.server.ports.numbers.items())
        self.get_logger().info(f"listening at {p.ports.address}: {numbers}")
        self.every(1.0 / p.truth_rate, self._report_truth)
        self.every(0.1, self._write_log)
        self.server.start()

    def _configure(self, new: SimulatedUrParameters) -> None:
        self.controller.faults = new.faults
        if new.pendant.speed_slider != self._slider:
            self._slider = self.controller.slider = new.pendant.speed_slider

    def _report_truth(self) -> None:
        measured = self.server.measured
        if self.controller.is_booting or measured is None:
            return
        self._truth_msg.header.stamp = self.stamp(measured.at)
        self._truth_msg.position = measured.q.tolist()
        self._truth_msg.velocity = measured.qd.tolist()
        self._truth.publish(self._truth_msg)

    def _write_log(self) -> None:
        log = self.controller.log
        while log:
            self.get_logger().info(log.popleft())

    def time_passed(self) -> None:
        """Let simulated time pass in the controller, and wait for its cycle."""
        if self._simulated_time is not None:
            self._simulated_time.set(self.now())
            self.server.wait_for_cycles()

    @property
    def progress(self) -> float:
        """Simulated time up to which the controller has run [s]."""
        return min(self.now(), self.server.done)

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        controller = self.controller
        values: list[tuple[str, object]] = [
            (f"port {name}", number) for name, number in self.server.ports.numbers.items()
        ]
        values += [(f"clients of {name}", n) for name, n in self.server.ports.clients.items()]
        values += [
            ("robot_mode", controller.modes.robot.name),
            ("safety_mode", controller.modes.safety.name),
            ("program_state", controller.runtime.name),
            ("program_end_reason", controller.end_reason),
            ("speed_slider", controller.slider),
            *((name, value) for name, value in vars(controller.counts).items()),
            ("late_cycles", self.server.late),
            ("lost_time", f"{self.server.lost:.3f}"),
        ]
        if self.server.error is not None:
            return DiagnosticStatus.ERROR, f"the simulation failed: {self.server.error!r}", values
        if self._ending:
            return DiagnosticStatus.WARN, "shutting down", values
        if not controller.arm.is_connected:
            return DiagnosticStatus.WARN, f"no arm: {controller.arm.failure}", values
        faults = active_faults(controller.faults)
        if faults:
            return DiagnosticStatus.WARN, f"faults: {', '.join(faults)}", values
        modes = controller.modes
        return DiagnosticStatus.OK, f"{modes.robot.name}, {modes.safety.name}", values

    def begin_shutdown(self, reason: str) -> None:
        """Switch the arm off, so that it brakes and its program ends."""
        self._ending = True
        self.server.shut_down()

    @property
    def finished(self) -> bool:
        """Whether the arm is at rest."""
        return self.controller.arm.still or self.server.error is not None

    @property
    def stop_timeout(self) -> float:
        """How long the arm may take to stop [s], with a margin of 1 s."""
        p = self.settings.value.simulated_arm
        return 1.0 + p.speed / p.protective_deceleration

    def destroy_node(self) -> None:
        """Close the ports, then destroy the node."""
        self.server.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_ur`."""
    return run(SimulatedUrNode, args)
