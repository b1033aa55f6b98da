"""Node `simulated_ur`: a UR5 with a CB3 controller on TCP, simulated."""

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.simulated_ur.arm import JOINTS, UrArmParameters
from omniman_ros.simulated_ur.faults import UrFaultParameters, active
from omniman_ros.simulated_ur.ports import UrPortParameters
from omniman_ros.simulated_ur.server import Server


@dataclass(frozen=True, kw_only=True)
class ArmNames:
    """Names of the joints, as all nodes of the arm have them."""

    joints: tuple[str, ...] = parameter(
        UR_JOINTS, "Names of the joints, from the base on; a prefix goes here.", read_only=True
    )

    def __post_init__(self) -> None:
        """Count the names.

        Raises:
            ParameterError: Not six different names.
        """
        if len(self.joints) != JOINTS or len(set(self.joints)) != JOINTS or not all(self.joints):
            raise ParameterError("arm.joints", self.joints, f"needs {JOINTS} different names")


@dataclass(frozen=True, kw_only=True)
class Pendant:
    """What a person sets at the pendant."""

    speed_slider: float = parameter(
        1.0, "Speed slider, while no RTDE client moves it.", low=0.01, high=1
    )


@dataclass(frozen=True, kw_only=True)
class SimulatedUrParameters:
    """Parameters of the node: ports, arm, pendant and faults."""

    arm: ArmNames
    ports: UrPortParameters
    simulated_arm: UrArmParameters
    pendant: Pendant
    faults: UrFaultParameters
    truth_rate: float = parameter(
        125.0, "Rate of ground_truth/arm_joint_states.", unit="Hz", low=1, high=1000,
        read_only=True,
    )  # fmt: skip


class SimulatedUrNode(OmnimanNode):
    """Plumbing around `simulated_ur.server.Server`: real controllers hear no topics."""

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_ur", **options)
        if self.get_parameter("use_sim_time").value:
            raise ParameterError("use_sim_time", True, "a controller on TCP runs on real time")
        self.settings = ParameterSet(self, SimulatedUrParameters)
        p = self.settings.value
        self.server = Server(p.simulated_arm, p.ports)
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
        self.every(0.1, self._tell)
        self.server.start()

    def _configure(self, new: SimulatedUrParameters) -> None:
        self.controller.faults = new.faults
        if new.pendant.speed_slider != self._slider:
            self._slider = self.controller.slider = new.pendant.speed_slider

    def _report_truth(self) -> None:
        arm = self.controller.arm
        self._truth_msg.header.stamp = self.stamp()
        self._truth_msg.position = arm.q.tolist()
        self._truth_msg.velocity = arm.qd.tolist()
        self._truth.publish(self._truth_msg)

    def _tell(self) -> None:
        """Pass on what the controller has to say."""
        log = self.controller.log
        while log:
            self.get_logger().info(log.popleft())

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        c = self.controller
        values: list[tuple[str, object]] = [
            (f"port {name}", number) for name, number in self.server.ports.numbers.items()
        ]
        values += [(f"clients of {name}", n) for name, n in self.server.ports.clients.items()]
        values += [
            ("robot_mode", c.modes.robot.name),
            ("safety_mode", c.modes.safety.name),
            ("program_state", c.runtime.name),
            ("program_end_reason", c.end_reason),
            ("speed_slider", c.slider),
            *((name, value) for name, value in vars(c.counts).items()),
            ("late_cycles", self.server.late),
            ("lost_time", f"{self.server.lost:.3f}"),
        ]
        if self.server.error is not None:
            return DiagnosticStatus.ERROR, f"the simulation failed: {self.server.error!r}", values
        if self._ending:
            return DiagnosticStatus.WARN, "shutting down", values
        on = active(c.faults)
        if on:
            return DiagnosticStatus.WARN, f"faults: {', '.join(on)}", values
        return DiagnosticStatus.OK, f"{c.modes.robot.name}, {c.modes.safety.name}", values

    def begin_shutdown(self, reason: str) -> None:
        """Switch the arm off: it brakes, and its program ends."""
        self._ending = True
        self.server.shut_down()

    @property
    def finished(self) -> bool:
        """Whether the arm stands."""
        return self.controller.arm.still or self.server.error is not None

    @property
    def patience(self) -> float:
        """How long the arm may take to stop [s]."""
        p = self.settings.value.simulated_arm
        return 1.0 + p.speed / p.protective_deceleration

    def destroy_node(self) -> None:
        """Close the ports, too."""
        self.server.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_ur`."""
    return run(SimulatedUrNode, args)
