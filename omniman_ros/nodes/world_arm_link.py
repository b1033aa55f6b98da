"""The arm of a simulated world at the end of its link to a controller."""

from dataclasses import replace
from typing import TYPE_CHECKING

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import SimulatedClock
from omniman_ros.simulation.arm_link.server import ArmLinkServer
from omniman_ros.simulation.link_connection import SimulationLinkError
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives

if TYPE_CHECKING:  # needs the physics engine, which is optional
    from omniman_ros.simulation.world.arm_servo import ArmServo

PARTICIPANT = "the arm's controller"  #: Name under which simulated time waits for the controller
SILENCE = 1.0  #: Time without a setpoint after which a controller counts as lost [s]


class WorldArmLink:
    """Passes a controller's setpoints to the arm's servo, and measurements back.

    Simulated time goes on as far as there are setpoints. A controller that is lost, silent or
    sends nonsense is disconnected with a warning, and the arm brakes.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(
        self,
        node: OmnimanNode,
        servo: "ArmServo",
        drives: SimulatedDrives,
        port: int,
        clock: SimulatedClock | None,
    ) -> None:
        self._node, self._servo, self._drives, self._clock = node, servo, drives, clock
        self._server = ArmLinkServer(port)
        self._arrival, self._refused = 0.0, 0
        node.get_logger().info(f"the arm waits for its controller at port {self._server.port}")

    @property
    def is_connected(self) -> bool:
        """Whether a controller is connected."""
        return self._server.is_connected

    def exchange(self, now: float) -> None:
        """Receive setpoints, and send the states measured since the last call, up to `now` [s]."""
        try:
            self._accept(now)
            for setpoint in self._server.receive():
                self._servo.follow(replace(setpoint, due=self._drives.elapsed(setpoint.due)))
                self._arrival = now
                if self._clock is not None:
                    self._clock.permit(PARTICIPANT, setpoint.due)
            for state in self._servo.take_states():
                self._server.send(state)
            if self._server.is_connected and now - self._arrival > SILENCE:
                raise SimulationLinkError(f"no setpoint for {SILENCE} s")
        except (SimulationLinkError, InputError) as error:
            self._node.warn("the arm's controller", f"{PARTICIPANT} is disconnected: {error}")
            self.disconnect()

    def _accept(self, now: float) -> None:
        if self._server.accept():
            self._arrival = now
            self._servo.take_states()
            self._server.send(self._servo.state())
            self._node.get_logger().info(f"{PARTICIPANT} is connected")
        if self._server.refused > self._refused:
            self._refused = self._server.refused
            self._node.warn("second controller", "a second controller of the arm is refused")

    def disconnect(self) -> None:
        """Disconnect the controller, if there is one; the arm brakes."""
        self._server.disconnect()
        self._servo.abandon()
        if self._clock is not None:
            self._clock.leave(PARTICIPANT)

    @property
    def at_rest(self) -> bool:
        """Whether the reference of the arm is at rest."""
        return not self._servo.reference.velocities.any()

    def close(self) -> None:
        """Close the port."""
        self._server.close()
