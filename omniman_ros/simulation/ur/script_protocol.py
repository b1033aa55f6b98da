"""Protocol of the ports that accept programs (30001, 30002, 30003), without sockets.

Source: Universal Robots, "Remote control via TCP/IP" and "Client interfaces", package "Robot
state" and "Version message"; Universal_Robots_Client_Library, test_primary_parser.cpp.
"""

import re
import struct
from dataclasses import dataclass

from omniman_ros.core.errors import InputError

#: Length of the longest program that is accepted [bytes]; that of ur_rtde has 38,000. Nobody is
#: served while a program is translated, which takes up to 30 s for one of this length.
MAX_PROGRAM_LENGTH = 1 << 18
#: Types of packages, and type of the robot message that reports the version
ROBOT_STATE, ROBOT_MESSAGE, VERSION_MESSAGE = 16, 20, 3
MODE_DATA, JOINT_DATA, CARTESIAN_INFO = 0, 1, 4  #: Types of the parts of a robot state
SOURCE = 254  #: Source of messages from the controller itself: -2 as an unsigned byte
PROJECT, BUILT = b"URControl", b"20-06-2022, 00:00:00"  #: The controller's software
REMOTE_CONTROL, SPEED_LIMIT = 1, 1.0  #: Control mode, and largest speed fraction

#: Strings as in the grammar, which has no escapes; one without an end takes the rest of its line,
#: so that no text is read twice
_TOKENS = re.compile(
    r"""(?P<skip>\#[^\n]*|"[^"\n]*"?|'[^'\n]*'?)"""
    r"""|\b(?P<word>def|sec|thread|if|while|switch|case|end)\b|\b(?P<default>default)\s*:"""
)
_BEGINS = re.compile(r"\s*(?:def|sec|thread)\b")


class ProgramReader:
    """Splits a stream of bytes into programs.

    A program ends with the line of its outermost `end`; a line outside of any block is a program
    of its own.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._lines: list[str] = []
        self._depth = 0
        self._length = 0

    def receive(self, data: bytes) -> list[str]:
        """Return the programs that bytes complete; one that is too long raises an InputError."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        programs = []
        for raw in lines:
            line = raw.decode("utf-8", errors="replace").rstrip("\r")
            program = self._append(line)
            if program:
                programs.append(program)
        if self._length + len(self._rest) > MAX_PROGRAM_LENGTH:
            raise InputError(f"a program must be at most {MAX_PROGRAM_LENGTH} bytes long")
        return programs

    def _append(self, line: str) -> str:
        if not self._lines and not _BEGINS.match(line):
            # Comments and blank lines between programs are ignored.
            text = "" if line.lstrip().startswith("#") else line.strip()
            return f"{text}\n" if text else ""
        self._lines.append(line)
        self._length += len(line) + 1
        self._depth += depth(line)
        if self._depth > 0:
            return ""
        program = "\n".join(self._lines) + "\n"
        self._lines, self._depth, self._length = [], 0, 0
        return program


def depth(line: str) -> int:
    """Return by how many levels a line of URScript deepens the nesting of blocks."""
    change = 0
    for token in _TOKENS.finditer(line):
        word = token["word"] or token["default"]
        if word is not None:
            change += -1 if word == "end" else 1
    return change


def version_message(version: tuple[int, int, int, int]) -> bytes:
    """Return the version message, which a client of 30001 and 30002 receives first."""
    major, minor, bugfix, build = version
    body = bytes([len(PROJECT)]) + PROJECT + struct.pack(">BBii", major, minor, bugfix, build)
    head = struct.pack(">QBB", 0, SOURCE, VERSION_MESSAGE)
    return _framed(ROBOT_MESSAGE, head + body + BUILT)


@dataclass(frozen=True)
class RobotState:
    """Content of the robot state message."""

    time: float  #: Time since the start of the controller [s]
    powered: bool  #: Whether the joints have power
    emergency_stopped: bool  #: Whether there is an emergency stop
    protective_stopped: bool  #: Whether there is a protective stop
    playing: bool  #: Whether the program runs
    paused: bool  #: Whether the program is paused
    robot_mode: int  #: Value of a `RobotMode`
    slider: float  #: Fraction of full speed that is set, 0 to 1
    scaling: float  #: Fraction of full speed that is in effect, 0 to 1
    actual_q: tuple[float, ...]  #: Joint angles [rad]
    target_q: tuple[float, ...]  #: Joint angles of the target [rad]
    actual_qd: tuple[float, ...]  #: Joint speeds [rad/s]
    current: tuple[float, ...]  #: Motor currents [A]
    joint_mode: int  #: Value of joint_mode, the same for each joint
    pose: tuple[float, ...]  #: Position [m] and rotation vector [rad] of the flange in the base


def robot_state(s: RobotState) -> bytes:
    """Return the robot state message: mode data, joint data and Cartesian info."""
    mode = struct.pack(
        ">Q7?BBdddB",
        round(s.time * 1e6),
        True,
        True,
        s.powered,
        s.emergency_stopped,
        s.protective_stopped,
        s.playing,
        s.paused,
        s.robot_mode,
        REMOTE_CONTROL,
        s.slider,
        s.scaling,
        SPEED_LIMIT,
        0,
    )
    joints = b"".join(
        struct.pack(">dddffffB", actual, target, speed, current, 48.0, 30.0, 0.0, s.joint_mode)
        for actual, target, speed, current in zip(
            s.actual_q, s.target_q, s.actual_qd, s.current, strict=True
        )
    )
    cartesian = struct.pack(">12d", *s.pose, *([0.0] * 6))
    parts = ((MODE_DATA, mode), (JOINT_DATA, joints), (CARTESIAN_INFO, cartesian))
    return _framed(ROBOT_STATE, b"".join(_framed(kind, body) for kind, body in parts))


def _framed(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body
