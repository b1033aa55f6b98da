"""The dashboard server: each line is answered by one line."""

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.ur.dashboard import DashboardSession
from omniman_ros.simulation.ur.modes import Cb3RobotMode, Cb3RuntimeState, Cb3SafetyMode


class Pendant:
    def __init__(self):
        self.runtime, self.robot_mode = Cb3RuntimeState.STOPPED, Cb3RobotMode.RUNNING
        self.safety_mode = Cb3SafetyMode.NORMAL
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
    return DashboardSession(pendant)


# A CB3 controller of version 3.15.8, from logs published by users.
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
def test_answers_equal_those_of_a_real_controller(dashboard, line, reply):
    assert dashboard.receive(f"{line}\n".encode()) == f"{reply}\n".encode()


@pytest.mark.parametrize(
    ("line", "asked", "yes", "no"),
    [
        ("play", ("play",), "Starting program", "Failed to execute: play"),
        ("pause", ("pause",), "Pausing program", "Failed to execute: pause"),
        ("stop", ("stop", "stopped by the dashboard"), "Stopped", "Failed to execute: stop"),
        (
            "unlock protective stop",
            ("unlock",),
            "Protective stop releasing",
            "Cannot unlock protective stop until 5s after occurrence. "
            "Always inspect cause of protective stop before unlocking",
        ),
        ("power on", ("power", Cb3RobotMode.IDLE), "Powering on", "Failed to execute: power on"),
        (
            "brake release",
            ("power", Cb3RobotMode.RUNNING),
            "Brake releasing",
            "Failed to execute: brake release",
        ),
        (
            "power off",
            ("power", Cb3RobotMode.POWER_OFF),
            "Powering off",
            "Failed to execute: power off",
        ),
    ],
)
def test_command_is_passed_on_and_its_outcome_returned(dashboard, pendant, line, asked, yes, no):
    assert dashboard.receive(f"{line}\r\n".encode()) == f"{yes}\n".encode()
    assert pendant.asked == [asked]
    pendant.can = False
    assert dashboard.receive(f"{line}\n".encode()) == f"{no}\n".encode()


@pytest.mark.parametrize(
    ("runtime", "state", "running"),
    [
        (Cb3RuntimeState.PLAYING, "PLAYING null", "true"),
        (Cb3RuntimeState.PAUSED, "PAUSED null", "false"),
        (Cb3RuntimeState.PAUSING, "PLAYING null", "false"),
        (Cb3RuntimeState.STOPPED, "STOPPED null", "false"),
    ],
)
def test_program_state_is_reported(dashboard, pendant, runtime, state, running):
    pendant.runtime = runtime
    expected = f"{state}\nProgram running: {running}\n".encode()
    assert dashboard.receive(b"programState\nrunning\n") == expected


def test_lines_may_arrive_in_any_pieces(dashboard):
    assert dashboard.receive(b"robot") == b""
    assert dashboard.receive(b"mode\nsafety") == b"Robotmode: RUNNING\n"
    assert dashboard.receive(b"mode\n") == b"Safetymode: NORMAL\n"


def test_quit_closes_the_connection(dashboard):
    assert dashboard.receive(b"quit\nrobotmode\n") == b"Disconnected\n"
    assert dashboard.closed


def test_line_without_an_end_is_rejected(dashboard):
    with pytest.raises(InputError):
        dashboard.receive(b"x" * 5000)
