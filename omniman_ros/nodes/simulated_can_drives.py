"""Node `simulated_can_drives`: simulated drives on a CAN bus, and the robot that they move."""

from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry

from omniman_ros.conversions.odometry import fill_odometry
from omniman_ros.core.errors import ParameterError
from omniman_ros.extras import CAN
from omniman_ros.nodes.can_receiver import CanReceiver, frame_age, open_bus
from omniman_ros.nodes.initial_pose_input import InitialPoseInput
from omniman_ros.nodes.paced_can_link import PacedCanLink
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.simulated_can_drives_parameters import SimulatedCanDrivesParameters
from omniman_ros.nodes.simulated_clock import ClockGiverNode, SimulatedClock
from omniman_ros.simulation.can_drives.parameters import FAULT_FLAGS

if TYPE_CHECKING:  # needs python-can, which is optional
    import can

PERIOD = 0.001  #: Period of the drives' firmware [s]
CLOCK_STEP = 0.005  #: Step of simulated time [s]
#: Interfaces of python-can that return the sender's own frames
ECHOING_INTERFACES = ("udp_multicast",)


class SimulatedCanDrivesNode(ClockGiverNode):
    """Connects a CAN bus to `simulation.can_drives.network.SimulatedBus`.

    As real drives do, the simulated ones receive frames and no topics. With `publish_clock`, the
    node gives simulated time, and a stream that bridge and drives wait for takes the place of the
    bus.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("simulated_can_drives", **options)
        if self.get_parameter("use_sim_time").value:
            raise ParameterError("use_sim_time", True, "the drives give time, or run on real time")
        self.settings = ParameterSet(self, SimulatedCanDrivesParameters)
        p = self.settings.value
        # Here, so that a machine without python-can can import this module for its parameters.
        from omniman_ros.simulation.can_drives.network import EchoFilter, SimulatedBus

        self.drives = SimulatedBus(p.robot, p.simulation, p.can, p.can_faults, p.seed)
        self.settings.on_change(self._update_parameters)
        self._echo_filter = EchoFilter() if p.can.interface in ECHOING_INTERFACES else None
        self._is_shutting_down = False
        self._truth = self.create_publisher(Odometry, "ground_truth/odom", 10)
        self._truth_message = Odometry(child_frame_id=p.base_frame)
        self._truth_message.header.frame_id = p.world_frame
        InitialPoseInput(self, p.world_frame, p.odom_frame, self.drives.set_pose)
        self._link: PacedCanLink | None = None
        self.give_clock(p, CLOCK_STEP)
        if self.simulated_clock is None:
            self._bus = open_bus(p.can)
            self._receiver = CanReceiver(self._bus, self._deliver)
            self.every(1.0 / p.truth_rate, self._publish_truth)
        else:
            self._link = PacedCanLink(self, p.bus_port, CLOCK_STEP, self.simulated_clock)
            self._truth_every = max(1, round(1.0 / (p.truth_rate * CLOCK_STEP)))
            self._steps = 0
        self.every(PERIOD, self.tick)

    def _deliver(self) -> None:
        executor = self.executor
        if executor is not None:
            executor.create_task(self.tick)

    def tick(self) -> None:
        """Deliver the received frames, run the drives up to now, and send their frames."""
        if self._link is not None and self.simulated_clock is not None:
            self._step(self._link, self.simulated_clock)
            return
        while self._receiver.received:
            message = self._receiver.received.popleft()
            at = self.now() - frame_age(message)
            if self._echo_filter is None or not self._echo_filter.is_echo(message, at):
                self._send(self.drives.receive(message, at))
        self._send(self.drives.advance(self.now()))
        if self._is_shutting_down and self.drives.at_rest:
            self.drives.release()
        while self._receiver.errors:
            self.warn("bus", f"cannot receive: {self._receiver.errors.popleft()}")

    def _step(self, link: PacedCanLink, clock: SimulatedClock) -> None:
        """Do as :meth:`tick`, as far as simulated time passes."""
        messages, now = link.receive(), self.now()
        if messages:
            answers = [frame for each in messages for frame in self.drives.receive(each, now)]
            link.send(answers, now)
        for _ in clock.steps():
            link.send(self.drives.advance(self.now()), self.now())
            self._steps += 1
            if self._steps % self._truth_every == 0:
                self._publish_truth()
        if self._is_shutting_down and self.drives.at_rest:
            self.drives.release()

    def _send(self, messages: "list[can.Message]") -> None:
        import can

        for message in messages:
            if self._echo_filter is not None:
                self._echo_filter.record_sent(message, self.now())
            try:
                self._bus.send(message)
            except (can.CanError, OSError, ValueError) as error:
                self.warn("send", f"cannot send: {error}")

    def _update_parameters(self, new: SimulatedCanDrivesParameters) -> None:
        self.drives.configure(new.robot, new.simulation, new.can_faults)

    def _publish_truth(self) -> None:
        """Publish pose and twist at the instant up to which the plant was simulated."""
        pose, twist = self.drives.ground_truth()
        stamp = self.stamp(self.drives.simulated_until)
        fill_odometry(self._truth_message, pose.tolist(), twist, np.zeros((3, 3)), stamp)
        self._truth.publish(self._truth_message)

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        faults = self.settings.value.can_faults
        values: list[tuple[str, object]] = [
            ("protocol", self.settings.value.can.protocol),
            ("frames_received", self.drives.received),
            ("frames_sent", self.drives.sent),
            ("frames_lost_by_fault", self.drives.lost),
            *self.pace_values(),
        ]
        played = {name: ", ".join(getattr(faults, name)) for name in (*FAULT_FLAGS, "reboot")}
        played |= {
            "supply": f"{faults.supply or ''}",
            "lost_frames": f"{faults.lost_frames or ''}",
        }
        on = [f"{name} ({what})" for name, what in played.items() if what]
        if self._is_shutting_down:
            return DiagnosticStatus.WARN, "shutting down", values
        if on:
            return DiagnosticStatus.WARN, f"faults: {'; '.join(on)}", values
        return DiagnosticStatus.OK, "running", values

    def begin_shutdown(self, reason: str) -> None:
        """Switch the drives off: each ramps its wheel to rest."""
        self._is_shutting_down = True
        self.drives.halt()
        super().begin_shutdown(reason)

    @property
    def finished(self) -> bool:
        """Whether all wheels stand."""
        return self.drives.at_rest

    @property
    def stop_timeout(self) -> float:
        """Longest time that the ramp to rest may take [s]."""
        firmware = self.settings.value.simulation.firmware
        return 1.0 + self.drives.fastest / firmware.quick_stop_deceleration

    def destroy_node(self) -> None:
        """Close the bus, then destroy the node."""
        if self._link is not None:
            self._link.close()
        else:
            self._receiver.close()
            self._bus.shutdown()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros simulated_can_drives`."""
    return run(SimulatedCanDrivesNode, args, CAN)
