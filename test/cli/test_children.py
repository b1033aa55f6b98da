import os
import queue
import signal
import subprocess
import sys

import pytest

from omniman_ros.cli.children import Children, Exit, Interrupt, Task, signals_to
from omniman_ros.cli.fleet import node_command
from omniman_ros.cli.up import supervise

from .support import is_alive, wait_until

pytestmark = pytest.mark.processes

# Says "ready", waits for a signal, says which, and ends after what the test adds.
FAKE = """\
import signal, sys
wanted = {signal.SIGINT, signal.SIGTERM}
signal.pthread_sigmask(signal.SIG_BLOCK, wanted)
print("ready", flush=True)
print(signal.Signals(signal.sigwait(wanted)).name, flush=True)
"""
SLOW = "signal.sigtimedwait({signal.SIGUSR1}, 0.2); print('rest', flush=True)"
DEAF = "signal.sigwait({signal.SIGUSR1})"
TIMEOUT = 20.0


def fake(name, stage=0, then=""):
    return Task(name, (sys.executable, "-S", "-E", "-c", FAKE + then), stage)


class Log:
    """Lines as they come, as pairs of name and text."""

    def __init__(self):
        self.all = []
        self._queue = queue.SimpleQueue()

    def __call__(self, name, line):
        self.all.append((name, line))
        self._queue.put((name, line))

    def await_ready(self, *names):
        waiting = set(names)
        while waiting:
            name, line = self._queue.get(timeout=TIMEOUT)
            if line == "ready":
                waiting.discard(name)

    def await_line(self, name, text):
        while self._queue.get(timeout=TIMEOUT) != (name, text):
            pass

    def of(self, name):
        return [line for who, line in self.all if who == name]


@pytest.fixture
def log():
    return Log()


@pytest.fixture
def said():
    return []


@pytest.fixture
def start(log, said):
    """Starts fakes; checks at the end that none is left."""
    groups = []

    def begin(*tasks, **options):
        children = Children(tasks, on_line=log, report=said.append, **options)
        groups.append((children, tasks))
        children.__enter__()
        log.await_ready(*[task.name for task in tasks])
        return children

    yield begin
    for children, tasks in groups:
        pids = [children.pid(task.name) for task in tasks]
        children.__exit__(None, None, None)
        assert not any(map(is_alive, pids))


def test_later_stages_start_first(log):
    tasks = [fake("controller", 0), fake("drive", 1)]
    with Children(tasks, on_line=log) as children:
        assert children.pid("drive") < children.pid("controller")


def test_stop_signals_each_stage_when_the_one_before_has_ended(start, log, said):
    children = start(fake("controller", 0, SLOW), fake("drive", 1))
    assert children.stop()
    assert log.all[-3:] == [("controller", "SIGINT"), ("controller", "rest"), ("drive", "SIGINT")]
    assert not said


def test_each_child_gets_its_signal_once(start, log):
    children = start(fake("one", 0, SLOW), fake("other", 0, SLOW))
    assert children.stop(signal.SIGTERM)
    assert children.stop()
    for name in ("one", "other"):
        assert log.of(name) == ["ready", "SIGTERM", "rest"]


def test_a_terminals_ctrl_c_does_not_reach_the_children(start):
    children = start(fake("node"))
    assert os.getsid(children.pid("node")) != os.getsid(0)


def test_a_death_is_an_event_with_name_and_code(start):
    children = start(fake("drive"), fake("controller"))
    assert children.next_event(0.0) is None
    os.kill(children.pid("drive"), signal.SIGKILL)
    event = children.next_event(TIMEOUT)
    assert event == Exit("drive", -signal.SIGKILL)
    assert str(event) == "drive was killed by SIGKILL"
    assert str(Exit("drive", 3)) == "drive ended with exit code 3"


def test_last_words_come_before_the_event(start, log):
    talk = "print('word\\n' * 5000 + 'bye', flush=True); sys.exit(3)"
    children = start(fake("node", then=talk))
    os.kill(children.pid("node"), signal.SIGINT)
    assert children.next_event(TIMEOUT) == Exit("node", 3)
    assert log.of("node")[-1] == "bye"


def test_when_one_dies_the_others_get_sigint_and_up_fails(start, log, capsys):
    children = start(fake("controller", 0), fake("drive", 1))
    os.kill(children.pid("drive"), signal.SIGKILL)
    assert supervise(children) == 1
    assert log.of("controller") == ["ready", "SIGINT"]
    assert "drive was killed by SIGKILL: stopping the robot" in capsys.readouterr().err


def test_a_child_that_ends_by_itself_is_no_success_even_with_code_0(start, log, capsys):
    children = start(fake("controller", 0), fake("drive", 1))
    os.kill(children.pid("controller"), signal.SIGINT)
    assert supervise(children) == 1
    assert "controller ended with exit code 0" in capsys.readouterr().err
    assert log.of("drive") == ["ready", "SIGINT"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_up_passes_a_signal_on_and_succeeds(start, log, number):
    children = start(fake("controller", 0), fake("drive", 1))
    with signals_to(children.interrupt):
        os.kill(os.getpid(), number)
        assert supervise(children) == 0
    passed = "SIGTERM" if number == signal.SIGHUP else signal.Signals(number).name
    assert log.all[-2:] == [("controller", passed), ("drive", passed)]


def test_up_fails_if_a_node_does_not_come_to_rest(start, said):
    children = start(fake("controller", 0, "sys.exit(1)"), fake("drive", 1))
    children.interrupt(signal.SIGINT)
    assert supervise(children) == 1
    assert said == ["controller ended with exit code 1"]


def test_a_second_signal_kills_all(start, log, said):
    children = start(fake("controller", 0, DEAF), fake("drive", 1))
    children.interrupt(signal.SIGINT)
    children.interrupt(signal.SIGINT)
    assert supervise(children) == 1
    assert said[0] == "second signal: killing all nodes"
    assert not is_alive(children.pid("drive"))
    assert log.of("drive") == ["ready"], "it was not left to the stage before it to end"


def test_a_child_that_is_deaf_is_killed_in_the_end(start, log, said):
    children = start(fake("controller", 0, DEAF), fake("drive", 1), patience=0.2)
    assert not children.stop()
    assert said[0] == "killing controller: no end 0.2 s after the signal"
    assert log.of("drive") == ["ready", "SIGINT"], "the drive is still stopped in order"


def test_killing_takes_along_what_the_child_started(start, log):
    spawn = (
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(99)'])\n"
        "print(child.pid, flush=True)\n" + DEAF
    )
    children = start(fake("node", 0, spawn), patience=1.0)
    assert not children.stop()
    grandchild = int(log.of("node")[-1])
    wait_until(lambda: not is_alive(grandchild), "the grandchild's end")


def test_what_cannot_be_started_leaves_none_behind(log):
    tasks = [Task("controller", ("/nowhere/command",), 0), fake("drive", 1)]
    children = Children(tasks, on_line=log)
    with pytest.raises(FileNotFoundError):
        children.__enter__()
    assert not is_alive(children.pid("drive"))


def test_children_end_with_a_with_block_that_raises(log):
    with (
        pytest.raises(RuntimeError),
        Children([fake("node")], on_line=log) as children,
    ):
        log.await_ready("node")
        raise RuntimeError
    assert not is_alive(children.pid("node"))


def test_signal_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT)
    with signals_to(lambda number: None):
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_interrupts_are_events(start):
    children = start(fake("node"))
    children.interrupt(signal.SIGTERM)
    assert children.next_event(TIMEOUT) == Interrupt(signal.SIGTERM)


@pytest.fixture
def fake_node(tmp_path, monkeypatch):
    """A module that `omniman_ros.cli.node` runs instead of a node."""
    package = tmp_path / "fakes"
    package.mkdir()
    (package / "__init__.py").write_text("")
    body = "\n    ".join(FAKE.splitlines())
    (package / "node.py").write_text(f"def main(args):\n    print(args)\n    {body}\n    return 7")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "fakes.node"


def test_a_node_process_runs_its_main_and_returns_its_code(start, log, fake_node):
    children = start(Task("node", node_command(fake_node, ["--ros-args"])))
    children.interrupt(signal.SIGINT)
    assert supervise(children) == 1
    assert log.of("node") == [str([fake_node, "--ros-args"]), "ready", "SIGINT"]


def test_a_node_gets_sigint_when_its_parent_is_killed(fake_node):
    code = (
        "import subprocess, signal\n"
        "from omniman_ros.cli.fleet import node_command\n"
        f"subprocess.Popen(node_command({fake_node!r}, []), start_new_session=True)\n"
        "signal.pause()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True
    )
    with parent:
        while parent.stdout.readline() != "ready\n":
            assert parent.poll() is None
        parent.kill()
        assert parent.stdout.read() == "SIGINT\n"


def test_a_node_whose_parent_is_gone_does_not_start(fake_node):
    command = list(node_command(fake_node, []))
    command[3] = "1"
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 1
    assert "is gone" in ended.stderr
    assert "ready" not in ended.stdout


def test_the_death_of_what_is_not_essential_is_reported_and_no_event():
    said = []
    tasks = [
        Task("page", (sys.executable, "-c", "raise SystemExit(3)"), essential=False),
        Task("node", ("sleep", "99")),
    ]
    with Children(tasks, report=said.append) as children:
        wait_until(lambda: children.check() or said, "the report")
        assert said == ["page ended with exit code 3: going on without it"]
        children.interrupt(signal.SIGTERM)
        assert children.next_event(TIMEOUT).number == signal.SIGTERM
