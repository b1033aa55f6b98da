import os
import queue
import signal
import subprocess
import sys

import pytest

from omniman_ros.cli.up import supervise
from omniman_ros.processes.process_group import (
    ProcessExit,
    ProcessGroup,
    ProcessSpec,
    ReceivedSignal,
    redirect_signals,
)
from omniman_ros.processes.robot_setup import node_command
from test.running import is_alive, wait_until

pytestmark = pytest.mark.processes

# Prints "ready", waits for a signal, prints its name, and ends after what the test appends.
FAKE_NODE = """\
import signal, sys
wanted = {signal.SIGINT, signal.SIGTERM}
signal.pthread_sigmask(signal.SIG_BLOCK, wanted)
print("ready", flush=True)
print(signal.Signals(signal.sigwait(wanted)).name, flush=True)
"""
SLOW_END = "signal.sigtimedwait({signal.SIGUSR1}, 0.2); print('rest', flush=True)"
NEVER_ENDS = "signal.sigwait({signal.SIGUSR1})"
TIMEOUT = 20.0


def fake_process(name, stage=0, then=""):
    return ProcessSpec(name, (sys.executable, "-S", "-E", "-c", FAKE_NODE + then), stage)


class Log:
    """Collects lines of output as pairs of name and text."""

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
def reports():
    return []


@pytest.fixture
def start(log, reports):
    """Return a function that starts processes; check at the end that none is left."""
    started = []

    def begin(*specs, **options):
        group = ProcessGroup(specs, on_line=log, report=reports.append, **options)
        started.append((group, specs))
        group.__enter__()
        log.await_ready(*[spec.name for spec in specs])
        return group

    yield begin
    for group, specs in started:
        pids = [group.pid(spec.name) for spec in specs]
        group.__exit__(None, None, None)
        assert not any(map(is_alive, pids))


def test_later_stages_start_first(log):
    specs = [fake_process("controller", 0), fake_process("drive", 1)]
    with ProcessGroup(specs, on_line=log) as group:
        assert group.pid("drive") < group.pid("controller")


def test_stop_signals_each_stage_when_the_one_before_has_ended(start, log, reports):
    group = start(fake_process("controller", 0, SLOW_END), fake_process("drive", 1))
    assert group.stop()
    assert log.all[-3:] == [("controller", "SIGINT"), ("controller", "rest"), ("drive", "SIGINT")]
    assert not reports


def test_each_process_gets_its_signal_once(start, log):
    group = start(fake_process("one", 0, SLOW_END), fake_process("other", 0, SLOW_END))
    assert group.stop(signal.SIGTERM)
    assert group.stop()
    for name in ("one", "other"):
        assert log.of(name) == ["ready", "SIGTERM", "rest"]


def test_a_terminals_ctrl_c_does_not_reach_the_processes(start):
    group = start(fake_process("node"))
    assert os.getsid(group.pid("node")) != os.getsid(0)


def test_the_end_of_a_process_is_an_event_with_name_and_code(start):
    group = start(fake_process("drive"), fake_process("controller"))
    assert group.next_event(0.0) is None
    os.kill(group.pid("drive"), signal.SIGKILL)
    event = group.next_event(TIMEOUT)
    assert event == ProcessExit("drive", -signal.SIGKILL)
    assert str(event) == "drive was killed by SIGKILL"
    assert str(ProcessExit("drive", 3)) == "drive ended with exit code 3"


def test_a_process_that_ends_before_it_handles_signals_is_no_failure():
    assert ProcessExit("node", -signal.SIGINT, asked=True).is_success
    assert not ProcessExit("node", -signal.SIGINT).is_success
    assert not ProcessExit("node", -signal.SIGTERM, asked=True).is_success


def test_the_last_output_comes_before_the_event(start, log):
    talk = "print('word\\n' * 5000 + 'bye', flush=True); sys.exit(3)"
    group = start(fake_process("node", then=talk))
    os.kill(group.pid("node"), signal.SIGINT)
    assert group.next_event(TIMEOUT) == ProcessExit("node", 3)
    assert log.of("node")[-1] == "bye"


def test_when_a_process_is_killed_the_others_get_sigint_and_up_fails(start, log, capsys):
    group = start(fake_process("controller", 0), fake_process("drive", 1))
    os.kill(group.pid("drive"), signal.SIGKILL)
    assert supervise(group) == 1
    assert log.of("controller") == ["ready", "SIGINT"]
    assert "drive was killed by SIGKILL: stopping the robot" in capsys.readouterr().err


def test_up_fails_if_a_node_ends_by_itself_even_with_code_0(start, log, capsys):
    group = start(fake_process("controller", 0), fake_process("drive", 1))
    os.kill(group.pid("controller"), signal.SIGINT)
    assert supervise(group) == 1
    assert "controller ended with exit code 0" in capsys.readouterr().err
    assert log.of("drive") == ["ready", "SIGINT"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_up_forwards_a_signal_and_succeeds(start, log, number):
    group = start(fake_process("controller", 0), fake_process("drive", 1))
    with redirect_signals(group.interrupt):
        os.kill(os.getpid(), number)
        assert supervise(group) == 0
    passed = "SIGTERM" if number == signal.SIGHUP else signal.Signals(number).name
    assert log.all[-2:] == [("controller", passed), ("drive", passed)]


def test_up_fails_if_a_node_does_not_come_to_rest(start, reports):
    group = start(fake_process("controller", 0, "sys.exit(1)"), fake_process("drive", 1))
    group.interrupt(signal.SIGINT)
    assert supervise(group) == 1
    assert reports == ["controller ended with exit code 1"]


def test_up_succeeds_though_the_middleware_of_a_node_at_rest_does_not_shut_down(start, reports):
    group = start(fake_process("controller", then="signal.raise_signal(signal.SIGALRM)"))
    group.interrupt(signal.SIGINT)
    assert supervise(group) == 0
    assert reports == ["controller came to rest, but its middleware did not shut down (SIGALRM)"]


def test_up_fails_if_an_alarm_ends_a_node_that_was_not_asked_to_end(start, log, reports, capsys):
    group = start(fake_process("controller", then="signal.raise_signal(signal.SIGALRM)"))
    os.kill(group.pid("controller"), signal.SIGINT)
    assert supervise(group) == 1
    assert "controller was killed by SIGALRM" in capsys.readouterr().err
    assert not reports


def test_a_second_signal_kills_all_processes(start, log, reports):
    group = start(fake_process("controller", 0, NEVER_ENDS), fake_process("drive", 1))
    group.interrupt(signal.SIGINT)
    group.interrupt(signal.SIGINT)
    assert supervise(group) == 1
    assert reports[0] == "second signal: killing all nodes"
    assert not is_alive(group.pid("drive"))
    assert log.of("drive") == ["ready"], "the drive was killed without a signal of its own"


def test_a_process_that_ignores_its_signal_is_killed_after_the_timeout(start, log, reports):
    group = start(
        fake_process("controller", 0, NEVER_ENDS), fake_process("drive", 1), stop_timeout=0.2
    )
    assert not group.stop()
    assert reports[0] == "killing controller: still running 0.2 s after the signal"
    assert log.of("drive") == ["ready", "SIGINT"], "the drive is stopped in order nevertheless"


def test_killing_a_process_also_kills_what_it_has_started(start, log):
    spawn = (
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(99)'])\n"
        "print(child.pid, flush=True)\n" + NEVER_ENDS
    )
    group = start(fake_process("node", 0, spawn), stop_timeout=1.0)
    assert not group.stop()
    grandchild = int(log.of("node")[-1])
    wait_until(lambda: not is_alive(grandchild), "the grandchild's end")


def test_if_a_process_cannot_start_none_is_left_running(log):
    specs = [ProcessSpec("controller", ("/nowhere/command",), 0), fake_process("drive", 1)]
    group = ProcessGroup(specs, on_line=log)
    with pytest.raises(FileNotFoundError):
        group.__enter__()
    assert not is_alive(group.pid("drive"))


def test_processes_end_with_a_with_block_that_raises(log):
    with (
        pytest.raises(RuntimeError),
        ProcessGroup([fake_process("node")], on_line=log) as group,
    ):
        log.await_ready("node")
        raise RuntimeError
    assert not is_alive(group.pid("node"))


def test_signal_handlers_are_restored():
    before = signal.getsignal(signal.SIGINT)
    with redirect_signals(lambda number: None):
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_received_signals_are_events(start):
    group = start(fake_process("node"))
    group.interrupt(signal.SIGTERM)
    assert group.next_event(TIMEOUT) == ReceivedSignal(signal.SIGTERM)


@pytest.fixture
def fake_node(tmp_path, monkeypatch):
    """Return the name of a module that run_node runs in place of a node."""
    package = tmp_path / "fakes"
    package.mkdir()
    (package / "__init__.py").write_text("")
    body = "\n    ".join(FAKE_NODE.splitlines())
    (package / "node.py").write_text(f"def main(args):\n    print(args)\n    {body}\n    return 7")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "fakes.node"


def test_a_node_process_runs_its_main_and_returns_its_code(start, log, fake_node):
    group = start(ProcessSpec("node", node_command(fake_node, ["--ros-args"])))
    group.interrupt(signal.SIGINT)
    assert supervise(group) == 1
    assert log.of("node") == [str([fake_node, "--ros-args"]), "ready", "SIGINT"]


def test_a_node_gets_sigint_when_its_parent_is_killed(fake_node):
    code = (
        "import subprocess, signal\n"
        "from omniman_ros.processes.robot_setup import node_command\n"
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


def test_the_end_of_a_process_that_is_not_essential_is_only_reported():
    reports = []
    specs = [
        ProcessSpec("page", (sys.executable, "-c", "raise SystemExit(3)"), essential=False),
        ProcessSpec("node", ("sleep", "99")),
    ]
    with ProcessGroup(specs, report=reports.append) as group:
        wait_until(lambda: group.check() or reports, "the report")
        assert reports == ["page ended with exit code 3: continuing without it"]
        group.interrupt(signal.SIGTERM)
        assert group.next_event(TIMEOUT).number == signal.SIGTERM
