"""Dashboard server without its socket: it replies with one line to each received line.

Source: Universal Robots, "Dashboard Server CB-Series, port 29999"; where it shows only examples,
the replies of a CB3 controller of version 3.15.8 that users have published.
"""

from collections.abc import Callable

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.modes import Cb3RobotMode, Cb3RuntimeState

GREETING = "Connected: Universal Robots Dashboard Server"  #: First line of the server
TOO_EARLY_REPLY = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)  #: Reply to an unlock that is refused
SOFTWARE = "URSoftware 3.15.8.106339 (Jun 20 2022)"  #: The controller's software
MAX_LINE = 4096  #: Length of the longest line that is accepted [bytes]


class DashboardSession:
    """Session of one client."""

    def __init__(self, controller: Cb3Controller) -> None:
        self.closed = False  #: Whether the client has sent `quit`
        self._controller = controller
        self._unread = b""

    def receive(self, data: bytes) -> bytes:
        """Return the replies to received bytes; a line above 4 KiB raises an InputError."""
        *lines, self._unread = (self._unread + data).split(b"\n")
        if len(self._unread) > MAX_LINE:
            raise InputError(f"a line must be at most {MAX_LINE} bytes long")
        replies = []
        for raw in lines:
            if self.closed:
                break
            replies.append(self._reply(raw.decode("utf-8", errors="replace").strip()) + "\n")
        return "".join(replies).encode()

    def _reply(self, line: str) -> str:
        plain_command = _PLAIN_COMMANDS.get(line.lower())
        if plain_command is not None:
            return plain_command(self)
        for prefix, command in _COMMANDS_WITH_ARGUMENT.items():
            if line.lower().startswith(prefix + " "):
                return command(self, line[len(prefix) + 1 :])
        return f'could not understand: "{line}"'

    def _play(self) -> str:
        return "Starting program" if self._controller.play() else "Failed to execute: play"

    def _stop(self) -> str:
        stopped = self._controller.stop("stopped by the dashboard")
        return "Stopped" if stopped else "Failed to execute: stop"

    def _pause(self) -> str:
        return "Pausing program" if self._controller.pause() else "Failed to execute: pause"

    def _quit(self) -> str:
        self.closed = True
        return "Disconnected"

    def _running(self) -> str:
        running = self._controller.runtime in (Cb3RuntimeState.PLAYING, Cb3RuntimeState.RESUMING)
        return f"Program running: {str(running).lower()}"

    def _program_state(self) -> str:
        runtime = self._controller.runtime
        if runtime in (Cb3RuntimeState.STOPPED, Cb3RuntimeState.STOPPING):
            return "STOPPED null"
        return f"{'PAUSED' if runtime is Cb3RuntimeState.PAUSED else 'PLAYING'} null"

    def _robot_mode(self) -> str:
        return f"Robotmode: {self._controller.robot_mode.name}"

    def _safety_mode(self) -> str:
        return f"Safetymode: {self._controller.safety_mode.name}"

    def _safety_status(self) -> str:
        return f"Safetystatus: {self._controller.safety_mode.name}"

    def _unlock(self) -> str:
        return "Protective stop releasing" if self._controller.unlock() else TOO_EARLY_REPLY

    def _power(self, wanted: Cb3RobotMode, reply: str, command: str) -> str:
        return reply if self._controller.power(wanted) else f"Failed to execute: {command}"

    def _popup(self, text: str) -> str:
        self._controller.popup(text)
        return "showing popup"

    def _close_popup(self) -> str:
        self._controller.close_popups()
        return "closing popup"

    def _log(self, text: str) -> str:
        self._controller.textmsg(text)
        return "Added log message"


def _always(reply: str) -> Callable[[DashboardSession], str]:
    return lambda _: reply


_PLAIN_COMMANDS: dict[str, Callable[[DashboardSession], str]] = {
    "play": DashboardSession._play,
    "stop": DashboardSession._stop,
    "pause": DashboardSession._pause,
    "quit": DashboardSession._quit,
    "running": DashboardSession._running,
    "programstate": DashboardSession._program_state,
    "robotmode": DashboardSession._robot_mode,
    "safetymode": DashboardSession._safety_mode,
    "safetystatus": DashboardSession._safety_status,
    "unlock protective stop": DashboardSession._unlock,
    "power on": lambda d: d._power(Cb3RobotMode.IDLE, "Powering on", "power on"),
    "power off": lambda d: d._power(Cb3RobotMode.POWER_OFF, "Powering off", "power off"),
    "brake release": lambda d: d._power(Cb3RobotMode.RUNNING, "Brake releasing", "brake release"),
    "close popup": DashboardSession._close_popup,
    "close safety popup": _always("closing safety popup"),
    "restart safety": _always("Restarting safety"),
    "polyscopeversion": _always(SOFTWARE),
    "version": _always(SOFTWARE),
    "get loaded program": _always("No program loaded"),
    "isprogramsaved": _always("true null"),
    "get robot model": _always("UR5"),
    "get serial number": _always("20000000000"),
    "shutdown": _always("Failed to execute: shutdown"),
}  #: Commands without an argument; case is ignored

_COMMANDS_WITH_ARGUMENT: dict[str, Callable[[DashboardSession, str], str]] = {
    "load installation": lambda d, name: f"File not found: {name}",
    "load": lambda d, name: f"File not found: {name}",
    "popup": DashboardSession._popup,
    "addtolog": DashboardSession._log,
    "setuserrole": lambda d, role: f"Setting user role: {role}",
}  #: Commands that an argument follows; this controller has no files
