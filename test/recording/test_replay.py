"""Replay of a recorded controller: what is equal, what differs, what is not judged."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from omniman_ros.cli.main import main
from omniman_ros.control.journal import Journal, pack, read_chunk
from omniman_ros.control.wheel_cascade import DriveMode
from test.control.rig import Rig
from test.recording.support import T, joints, write

NAMES = ("front_left", "front_right", "rear_left", "rear_right")
TICKS, CHUNK = 400, 20


def nanoseconds(seconds):
    return round(seconds * 1e9)


def command_message(now, command):
    velocity = () if command.velocity is None else command.velocity
    return joints(now, NAMES, velocity=velocity, effort=command.effort)


def journal_message(data):
    layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
    return T["std_msgs/msg/UInt8MultiArray"](layout, np.frombuffer(data, np.uint8))


@pytest.fixture
def messages():
    """The messages of a drive: 40 ticks before the journal, and 400 within it."""
    rig, rows = Rig(), []
    journal = Journal(rig.core)
    for number in range(-40, TICKS):
        if number == 0:
            journal.open(5)
            rows.append((rig.now, "/controller_journal", journal_message(journal.take())))
        if number % 4 == 0:
            rig.twist(0.4, 0.1, 0.3)
        command = rig.tick()
        if command is not None:
            topic = "voltages" if command.mode is DriveMode.VOLTAGE else "commands"
            message = command_message(rig.now, command)
            rows.append((rig.now, f"/wheel_{topic}", message))
            stamp = message.header.stamp
            journal.note_published(stamp.sec * 10**9 + stamp.nanosec)
        if number >= 0 and number % CHUNK == CHUNK - 1:
            rows.append((rig.now, "/controller_journal", journal_message(journal.take())))
    return [*rows, (rig.now, "/wheel_states", joints(rig.now, NAMES, velocity=[0.0] * 4))]


def run(capsys, folder):
    code = main(["replay", str(folder)])
    captured = capsys.readouterr()
    return code, captured.out + captured.err


def places(messages, topic):
    return [i for i, (_, name, _) in enumerate(messages) if name == topic]


def test_recorded_drive_is_repeated_and_what_came_before_is_not_judged(messages, tmp_path, capsys):
    code, text = run(capsys, write(tmp_path / "bag", messages))
    before = len(places(messages, "/wheel_commands")) - TICKS
    assert code == 0, text
    assert f"{TICKS} ticks repeated" in text
    assert f"wheel_commands: {TICKS} equal, 0 different" in text
    assert f"wheel_commands: {before} not judged, outside of the journal" in text


def test_changed_bit_of_one_recorded_value_is_shown(messages, tmp_path, capsys):
    at = places(messages, "/wheel_commands")[200]
    now, _, message = messages[at]
    was = message.velocity[2]
    message.velocity[2] = np.nextafter(was, np.inf)
    code, text = run(capsys, write(tmp_path / "bag", messages))
    assert code == 1
    assert f"{TICKS - 1} equal, 1 different" in text
    assert f"wheel_commands at {nanoseconds(now) / 1e9:.4f}" in text
    changed, old = float(message.velocity[2]), float(was)
    assert f"velocity[rear_left]: recorded {changed!r}, replayed {old!r}" in text


def test_another_gain_in_the_journal_is_shown(messages, tmp_path, capsys):
    at = places(messages, "/controller_journal")[0]
    now, topic, message = messages[at]
    chunk = read_chunk(bytes(message.data))
    core = pickle.loads(chunk.state)
    coupling = core.parameters.coupling
    changed = replace(coupling, k_epsilon=2.0 * coupling.k_epsilon)
    core.configure(replace(core.parameters, coupling=changed))
    chunk = replace(chunk, state=pickle.dumps(core))
    messages[at] = now, topic, journal_message(pack(chunk))
    code, text = run(capsys, write(tmp_path / "bag", messages))
    assert code == 1, text
    assert "First difference: wheel_commands at" in text


def test_after_a_lost_part_of_the_journal_nothing_is_judged(messages, tmp_path, capsys):
    del messages[places(messages, "/controller_journal")[6]]  # the first has the state alone
    code, text = run(capsys, write(tmp_path / "bag", messages))
    assert code == 0
    assert f"wheel_commands: {5 * CHUNK} equal, 0 different" in text
    assert "Gaps in the journal: 1" in text


def test_lost_command_is_not_judged(messages, tmp_path, capsys):
    del messages[places(messages, "/wheel_commands")[-1]]
    code, text = run(capsys, write(tmp_path / "bag", messages))
    assert code == 0
    assert "wheel_commands: 1 not judged, not in the recording" in text


@pytest.mark.parametrize(
    ("left_out", "reason"),
    [
        ("/controller_journal", "no controller_journal"),
        ("/wheel_commands", "no command is judged"),
    ],
)
def test_recording_without_journal_or_commands_cannot_be_replayed(
    left_out, reason, messages, tmp_path, capsys
):
    kept = [row for row in messages if row[1] != left_out]
    code, text = run(capsys, write(tmp_path / "bag", kept))
    assert code == 2
    assert reason in text


def test_damaged_journal_cannot_be_replayed(messages, tmp_path, capsys):
    at = places(messages, "/controller_journal")[2]
    now, topic, message = messages[at]
    messages[at] = now, topic, journal_message(bytes(message.data)[:-9])
    code, text = run(capsys, write(tmp_path / "bag", messages))
    assert code == 2
    assert "the journal is damaged" in text
