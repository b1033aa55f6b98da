"""The journal of a platform controller, and its replay."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.journal import Journal, pack, read_chunk, replay, restore
from omniman_ros.core.arbiter import Source
from omniman_ros.core.errors import InputError, OmnimanError
from test.control.rig import Rig


def drive(rig, after_tick=lambda: None):
    """Drive by twists, a preview and voltages, with a refused input, a stop and a reset."""

    def run(seconds, feed=lambda: None):
        for _ in range(round(seconds / 0.02)):
            feed()
            for _ in range(4):
                rig.tick()
                after_tick()

    run(1.0, lambda: rig.twist(0.5, -0.3, 0.4))
    with pytest.raises(InputError):
        rig.twist(np.nan, 0.0, 0.0)
    run(2.0)
    rig.core.set_preview(Source.PATH, rig.move((0.3, 0.2, 0.1), 2.0), rig.now)
    run(1.0)
    rig.core.set_pose((1.0, 2.0, 0.5))
    run(2.0)
    run(0.3, lambda: rig.core.set_voltages(np.full(rig.count, 3.0), rig.now))
    rig.core.latch.stop("tried")
    run(1.5)
    rig.core.reset(rig.now)
    run(0.5, lambda: rig.twist(0.2, 0.0, 0.0))
    return rig


def journal_of(rig, begin=lambda rig: rig.run(0.1)):
    """Return the chunk of a drive, and the ticks that were driven meanwhile."""
    begin(rig)
    journal, since = Journal(rig.core), len(rig.commands)
    journal.open(7)
    drive(rig)
    return read_chunk(journal.take()), rig.commands[since:]


def with_gain(parameters):
    coupling = parameters.coupling
    return replace(parameters, coupling=replace(coupling, k_epsilon=1.01 * coupling.k_epsilon))


def bits(commands):
    return [
        command
        and (
            command.mode,
            command.effort.tobytes(),
            None if command.velocity is None else command.velocity.tobytes(),
        )
        for command in commands
    ]


def test_recorded_calls_replay_bit_for_bit_from_the_middle_of_a_motion():
    chunk, driven = journal_of(Rig(), lambda rig: rig.cruise(0.3, 0.2, 0.1))
    replayed = [tick.command for tick in replay(restore(chunk), chunk.entries)]
    assert len(driven) > 1500 and any(c is not None and c.effort.any() for c in driven)
    assert bits(replayed) == bits(driven)


def test_another_gain_is_a_difference():
    chunk, driven = journal_of(Rig())
    core = restore(chunk)
    core.configure(with_gain(core.parameters))
    replayed = [tick.command for tick in replay(core, chunk.entries)]
    assert bits(replayed) != bits(driven)


def test_the_journal_changes_nothing_and_notes_nothing_after_its_end():
    noted, plain = Rig(), Rig()
    journal = Journal(noted.core)
    journal.open(1)
    assert drive(noted).trace() == drive(plain).trace()
    journal.close()
    assert vars(noted.core).keys() == vars(plain.core).keys()
    noted.tick()
    assert read_chunk(journal.take()).entries == ()


def test_the_stamp_of_a_command_belongs_to_its_tick():
    rig = Rig().run(0.1)
    journal = Journal(rig.core)
    journal.open(1)
    rig.tick()
    journal.note_published(12)
    rig.tick()
    chunk = read_chunk(journal.take())
    ticks = list(replay(restore(chunk), chunk.entries))
    assert [tick.stamp for tick in ticks] == [12, None]
    assert ticks[1].now == rig.now


class Harm:
    def __reduce__(self):
        return print, ("harm",)


@pytest.mark.parametrize("content", [Harm(), 3, (7, 0, b"", ())])
def test_foreign_content_is_refused_and_never_run(content, capsys):
    with pytest.raises(InputError, match="journal c"):
        read_chunk(pack(content))
    assert "harm" not in capsys.readouterr().out


def test_damaged_content_is_refused_before_it_is_read():
    journal = Journal(Rig().core)
    journal.open(1)
    data = journal.take()
    assert read_chunk(data).segment == 1
    for place in range(0, len(data), 97):
        damaged = bytearray(data)
        damaged[place] ^= 1
        with pytest.raises(InputError, match="damaged"):
            read_chunk(bytes(damaged))
    for short in (b"", b"nonsense", data[:-1]):
        with pytest.raises(InputError, match="damaged"):
            read_chunk(short)


def test_what_another_version_takes_otherwise_is_refused():
    entries = [pickle.dumps(("set_twist", ("fast",), {})), pickle.dumps(("tick", (), {}))]
    for entry in entries:
        with pytest.raises(InputError, match="this version has another"):
            list(replay(Rig().core, [entry]))


@pytest.mark.parametrize("name", ["no_such_call", "parameters.__init__"])
def test_call_that_this_version_has_not_is_refused(name):
    entry = pickle.dumps((name, (), {}))
    with pytest.raises(OmnimanError, match="has not"):
        list(replay(Rig().core, [entry]))
