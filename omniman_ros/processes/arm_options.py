"""Choice of the arm's controller: a simulated one on this machine, a real one, or none."""

from omniman_ros.console.errors import CommandError
from omniman_ros.processes.free_ports import are_free, find_free_ports

ARMS = {
    "simulated": "a simulated UR5 controller on this machine",
    "ur": "the controller of --controller",
    "none": "there is no arm",
}  #: Descriptions of the values of `--arm`

UR_PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
}  #: TCP ports of every UR controller, by interface

#: Lag of an arm in a world [s]: that of the simulated controller's own joints, 0.042, and 0.02
#: more for the link and for the sampling of its setpoints.
WORLD_SERVO_LAG = 0.062

#: Parameters that lengthen the client's timeouts for a simulated controller.
#: Unlike a real one, it is a process that may have to wait on a busy machine.
SIMULATED_CONTROLLER_TIMEOUTS = ("ur.read_timeout:=0.2", "ur.feedback_timeout:=0.5")


def resolve_arm(arm: str | None, drive: str, sim_time: bool) -> str:
    """Return the kind of arm; without `--arm` a simulated one, but none with real drives.

    Raises:
        CommandError: A real arm was requested together with simulated time.
    """
    if arm is None:
        return "none" if drive == "real" else "simulated"
    if sim_time and arm == "ur":
        raise CommandError(f"--sim-time: the arm '{arm}' runs on real time", 2)
    return arm


def private_controller_arguments() -> list[str]:
    """Return the arguments of a simulated controller on this machine and of its client.

    They communicate on the ports of a UR controller, or on other free ones if any of these is in
    use.
    """
    ports = UR_PORTS
    if not are_free(UR_PORTS.values()):
        ports = dict(zip(UR_PORTS, find_free_ports(len(UR_PORTS)), strict=True))
    parameters = [
        *(f"ports.{name}:={port}" for name, port in ports.items()),
        f"ur.dashboard_port:={ports['dashboard']}",
        f"ur.script_port:={ports['secondary']}",
        f"ur.rtde_port:={ports['rtde']}",
        "ur.reverse_port:=0",
        "ur.host:=127.0.0.1",
        "ur.unlock:=true",
        *SIMULATED_CONTROLLER_TIMEOUTS,
    ]
    return [argument for parameter in parameters for argument in ("-p", parameter)]


def world_arm_arguments() -> dict[str, list[str]]:
    """Return the arguments of the nodes that move the arm of a world, by the node's name."""
    (port,) = find_free_ports(1)
    return {
        "simulated_world": ["-p", f"arm_port:={port}"],
        "simulated_ur": ["-p", f"simulated_arm.world_port:={port}"],
        "arm_streamer": ["-p", f"ur.servo_lag:={WORLD_SERVO_LAG}"],
    }
