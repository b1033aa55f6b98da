"""The dashboard: a line for a line, without a socket.

Source: Universal Robots, "Dashboard Server CB-Series, port 29999"; where it shows only examples,
the replies of a CB3 controller of version 3.15.8 that users have published.
"""

from collections.abc import Callable
from typing import Protocol

from omniman_ros.core.errors import InputError
from omniman_ros.simulated_ur.modes import RobotMode, Runtime, SafetyMode

GREETING = "Connected: Universal Robots Dashboard Server"
TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)
SOFTWARE = "URSoftware 3.15.8.106339 (Jun 20 2022)"
LONGEST = 4096
"""Longest line, in bytes."""


class Pendant(Protocol):
    """What a person with the pendant could do and see."""

    @property
    def runtime(self) -> Runtime:
        """Of the program."""
        ...

    @property
    def robot_mode(self) -> RobotMode:
        """Of the arm."""
        ...

    @property
    def safety_mode(self) -> SafetyMode:
        """Of the safety system."""
        ...

    def play(self) -> bool:
        """Go on with a program that is paused; false if there is none or it must not move."""
        ...

    def stop(self, reason: str) -> bool:
        """End the program; false if there is none."""
        ...

    def pause(self) -> bool:
        """Pause the program; false if none is playing."""
        ...

    def unlock(self) -> bool:
        """Unlock the protective stop; false if it is too early, or there is none."""
        ...

    def power(self, wanted: RobotMode) -> bool:
        """Switch power and brakes: POWER_OFF, IDLE or RUNNING; false if that is not possible."""
        ...

    def popup(self, text: str) -> None:
        """Show a text."""
        ...

    def close_popups(self) -> None:
        """Close what is shown."""
        ...

    def textmsg(self, text: str) -> None:
        """Write a line into the log."""
        ...


class Dashboard:
    """One client of the dashboard.

    Attributes:
        closed: Whether it has said `quit`.
    """

    def __init__(self, pendant: Pendant) -> None:
        self.closed = False
        self._pendant = pendant
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they come and return the replies.

        Raises:
            InputError: A line is longer than 4 KiB.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST:
            raise InputError(f"a line of more than {LONGEST} bytes")
        replies = []
        for raw in lines:
            if self.closed:
                break
            replies.append(self._reply(raw.decode("utf-8", errors="replace").strip()) + "\n")
        return "".join(replies).encode()

    def _reply(self, line: str) -> str:
        known = _COMMANDS.get(line.lower())
        if known is not None:
            return known(self)
        for prefix, command in _WITH_WORDS.items():
            if line.lower().startswith(prefix + " "):
                return command(self, line[len(prefix) + 1 :])
        return f'could not understand: "{line}"'

    # ---- commands -----------------------------------------------------------------------------

    def _play(self) -> str:
        return "Starting program" if self._pendant.play() else "Failed to execute: play"

    def _stop(self) -> str:
        stopped = self._pendant.stop("stopped by the dashboard")
        return "Stopped" if stopped else "Failed to execute: stop"

    def _pause(self) -> str:
        return "Pausing program" if self._pendant.pause() else "Failed to execute: pause"

    def _quit(self) -> str:
        self.closed = True
        return "Disconnected"

    def _running(self) -> str:
        running = self._pendant.runtime in (Runtime.PLAYING, Runtime.RESUMING)
        return f"Program running: {str(running).lower()}"

    def _program_state(self) -> str:
        runtime = self._pendant.runtime
        if runtime in (Runtime.STOPPED, Runtime.STOPPING):
            return "STOPPED null"
        return f"{'PAUSED' if runtime is Runtime.PAUSED else 'PLAYING'} null"

    def _robot_mode(self) -> str:
        return f"Robotmode: {self._pendant.robot_mode.name}"

    def _safety_mode(self) -> str:
        return f"Safetymode: {self._pendant.safety_mode.name}"

    def _safety_status(self) -> str:
        return f"Safetystatus: {self._pendant.safety_mode.name}"

    def _unlock(self) -> str:
        return "Protective stop releasing" if self._pendant.unlock() else TOO_EARLY

    def _power(self, wanted: RobotMode, reply: str, command: str) -> str:
        return reply if self._pendant.power(wanted) else f"Failed to execute: {command}"

    def _popup(self, text: str) -> str:
        self._pendant.popup(text)
        return "showing popup"

    def _close_popup(self) -> str:
        self._pendant.close_popups()
        return "closing popup"

    def _log(self, text: str) -> str:
        self._pendant.textmsg(text)
        return "Added log message"


def _always(reply: str) -> Callable[[Dashboard], str]:
    return lambda _: reply


_COMMANDS: dict[str, Callable[[Dashboard], str]] = {
    "play": Dashboard._play,
    "stop": Dashboard._stop,
    "pause": Dashboard._pause,
    "quit": Dashboard._quit,
    "running": Dashboard._running,
    "programstate": Dashboard._program_state,
    "robotmode": Dashboard._robot_mode,
    "safetymode": Dashboard._safety_mode,
    "safetystatus": Dashboard._safety_status,
    "unlock protective stop": Dashboard._unlock,
    "power on": lambda d: d._power(RobotMode.IDLE, "Powering on", "power on"),
    "power off": lambda d: d._power(RobotMode.POWER_OFF, "Powering off", "power off"),
    "brake release": lambda d: d._power(RobotMode.RUNNING, "Brake releasing", "brake release"),
    "close popup": Dashboard._close_popup,
    "close safety popup": _always("closing safety popup"),
    "restart safety": _always("Restarting safety"),
    "polyscopeversion": _always(SOFTWARE),
    "version": _always(SOFTWARE),
    "get loaded program": _always("No program loaded"),
    "isprogramsaved": _always("true null"),
    "get robot model": _always("UR5"),
    "get serial number": _always("20000000000"),
    "shutdown": _always("Failed to execute: shutdown"),
}
"""Commands without words; matched without regard to case."""

_WITH_WORDS: dict[str, Callable[[Dashboard, str], str]] = {
    "load installation": lambda d, name: f"File not found: {name}",
    "load": lambda d, name: f"File not found: {name}",
    "popup": Dashboard._popup,
    "addtolog": Dashboard._log,
    "setuserrole": lambda d, role: f"Setting user role: {role}",
}
"""Commands that words follow; this controller has no files."""
