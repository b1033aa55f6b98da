"""Dashboard: a line for a line."""

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulated_ur.dashboard import Dashboard
from omniman_ros.simulated_ur.modes import RobotMode, Runtime, SafetyMode


class Pendant:
    def __init__(self):
        self.runtime, self.robot_mode = Runtime.STOPPED, RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self.can = True
        self.asked = []

    def __getattr__(self, name):
        def ask(*words):
            self.asked.append((name, *words))
            return self.can

        return ask


@pytest.fixture
def pendant():
    return Pendant()


@pytest.fixture
def dashboard(pendant):
    return Dashboard(pendant)


# A CB3 controller of version 3.15.8, as users have shown it.
@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("running", "Program running: false"),
        ("get loaded program", "No program loaded"),
        ("programState", "STOPPED null"),
        ("PolyscopeVersion", "URSoftware 3.15.8.106339 (Jun 20 2022)"),
        ("load x.urp", "File not found: x.urp"),
        ("is in remote control", 'could not understand: "is in remote control"'),
        ("popup hello", "showing popup"),
        ("popup", 'could not understand: "popup"'),
        ("", 'could not understand: ""'),
    ],
)
def test_lines_are_answered_as_by_a_real_controller(dashboard, line, reply):
    assert dashboard.receive(f"{line}\n".encode()) == f"{reply}\n".encode()


@pytest.mark.parametrize(
    ("line", "asked", "yes", "no"),
    [
        ("play", ("play",), "Starting program", "Failed to execute: play"),
        ("pause", ("pause",), "Pausing program", "Failed to execute: pause"),
        ("stop", ("stop", "stopped by the dashboard"), "Stopped", "Failed to execute: stop"),
        ("unlock protective stop", ("unlock",), "Protective stop releasing",
         "Cannot unlock protective stop until 5s after occurrence. "
         "Always inspect cause of protective stop before unlocking"),
        ("power on", ("power", RobotMode.IDLE), "Powering on", "Failed to execute: power on"),
        ("brake release", ("power", RobotMode.RUNNING), "Brake releasing",
         "Failed to execute: brake release"),
        ("power off", ("power", RobotMode.POWER_OFF), "Powering off",
         "Failed to execute: power off"),
    ],
)  # fmt: skip
def test_a_command_is_passed_on_and_its_outcome_told(dashboard, pendant, line, asked, yes, no):
    assert dashboard.receive(f"{line}\r\n".encode()) == f"{yes}\n".encode()
    assert pendant.asked == [asked]
    pendant.can = False
    assert dashboard.receive(f"{line}\n".encode()) == f"{no}\n".encode()


@pytest.mark.parametrize(
    ("runtime", "state", "running"),
    [(Runtime.PLAYING, "PLAYING null", "true"), (Runtime.PAUSED, "PAUSED null", "false"),
     (Runtime.PAUSING, "PLAYING null", "false"), (Runtime.STOPPED, "STOPPED null", "false")],
)  # fmt: skip
def test_the_state_of_the_program_is_told(dashboard, pendant, runtime, state, running):
    pendant.runtime = runtime
    expected = f"{state}\nProgram running: {running}\n".encode()
    assert dashboard.receive(b"programState\nrunning\n") == expected


def test_lines_may_come_in_any_pieces(dashboard):
    assert dashboard.receive(b"robot") == b""
    assert dashboard.receive(b"mode\nsafety") == b"Robotmode: RUNNING\n"
    assert dashboard.receive(b"mode\n") == b"Safetymode: NORMAL\n"


def test_quit_closes(dashboard):
    assert dashboard.receive(b"quit\nrobotmode\n") == b"Disconnected\n"
    assert dashboard.closed


def test_a_line_without_an_end_is_refused(dashboard):
    with pytest.raises(InputError):
        dashboard.receive(b"x" * 5000)
