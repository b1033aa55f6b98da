import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from omniman_ros.cli.main import make_parser
from omniman_ros.console.errors import CommandError
from omniman_ros.console.results import rounded
from omniman_ros.console.session import Session
from omniman_ros.lab.bench import arm as bench_arm
from omniman_ros.lab.bench import arm_bare as bench_arm_bare
from omniman_ros.lab.bench.arm import child_of, effort_of, scheduling
from omniman_ros.lab.bench.arm_figures import (
    Block,
    Pair,
    aims,
    controller_figures,
    ended_programs,
    figures,
    report,
    spread,
    summary,
)
from omniman_ros.lab.bench.arm_load import Load
from omniman_ros.lab.bench.harness import free_ports
from test.running import Running, children_of, command, environment, is_alive, wait_until

LENIENT = ("-p", "ur.read_timeout:=0.2")
"""A busy machine is no fault of the streamer; it is what the bench measures, and no test."""


def steady(value, count=100):
    return Block((value,) * count)


def pair(ours, bare, beside=0.008):
    return Pair(steady(ours), steady(bare), steady(beside))


def diagnostics(**changes):
    """Return diagnostics of a controller that runs the first program."""
    values = {
        "programs": "1",
        "program_state": "PLAYING",
        "servo_calls": "100",
        "servo_gaps": "0",
        "protective_stops": "0",
        "late_cycles": "2",
        "lost_time": "0.500",
    }
    return values | {name: str(value) for name, value in changes.items()}


def result(ratio=1.0, read_timeouts=0):
    ours = Block([0.008] * 98 + [0.013, 0.021], [0.003, 0.004])
    whole = figures([Pair(ours, steady(0.0085), steady(0.009))]) | {
        "ratio": ratio,
        "scheduling": {"streamer": "SCHED_FIFO 50", "bare": "SCHED_FIFO 50"},
        "cpu_share": {"streaming": 0.09, "node": 0.12, "bare": 0.007},
        "controller": {"read_timeouts": read_timeouts},
    }
    return whole | {"aims": aims(whole)}


# ---- statistics ---------------------------------------------------------------------------------


def test_spread_has_count_median_p99_and_maximum_in_milliseconds():
    found = spread([0.001 * k for k in range(101)])
    assert found == pytest.approx({"count": 101, "p50_ms": 50.0, "p99_ms": 99.0, "max_ms": 100.0})


def test_spread_of_no_samples_has_no_figures():
    assert spread([], "age_") == {"age_count": 0}


def test_gaps_are_counted_strictly_above_their_bounds():
    found = summary([Block([0.008, 0.012, 0.0121]), Block([0.020, 0.0201])])
    assert (found["count"], found["above_12_ms"], found["above_20_ms"]) == (5, 3, 1)


def test_ages_have_figures_only_where_samples_exist():
    assert not [key for key in summary([Block([0.008])]) if key.startswith("age")]
    found = summary([Block([0.008], [0.002]), Block([0.008], [0.004])])
    assert (found["age_count"], found["age_p50_ms"]) == (2, pytest.approx(3.0))


def test_ratio_is_the_median_over_pairs_of_the_p99_ratios():
    found = figures([pair(0.008, 0.008), pair(0.024, 0.008), pair(0.012, 0.008)])
    assert found["pair_ratios"] == pytest.approx([1.0, 3.0, 1.5])
    assert found["ratio"] == pytest.approx(1.5)


def test_concurrent_ratio_is_of_the_streamer_while_the_bare_loop_runs():
    found = figures([pair(0.016, 0.008, beside=0.010)])
    assert found["ratio_beside"] == pytest.approx(1.25)
    assert found["pair_p99_ms"] == [pytest.approx([16.0, 8.0])]


def test_p99_differs_from_median_and_maximum():
    values = [0.008] * 95 + [0.010] * 5 + [0.5]
    assert figures([Pair(Block(values), steady(0.008), steady(0.008))])["ratio"] == 1.25


@pytest.mark.parametrize(
    ("changes", "ended"),
    [
        ({}, 0),
        ({"program_state": "STOPPED"}, 1),
        ({"programs": 3}, 2),
        ({"programs": 0, "program_state": "STOPPED"}, 0),
    ],
)
def test_ended_programs_are_all_started_ones_except_the_running_one(changes, ended):
    values = diagnostics(**changes)
    assert ended_programs(values) == ended


def test_events_before_the_measurement_do_not_count_on_the_ur_side():
    before = diagnostics(programs=3, servo_gaps=7)
    after = diagnostics(programs=4, servo_gaps=9, servo_calls=350, late_cycles=2, lost_time=0.75)
    found = controller_figures(before, after)
    assert found["read_timeouts"] == 1
    assert (found["servo_gaps"], found["servo_calls"], found["late_cycles"]) == (2, 250, 0)
    assert found["lost_time_s"] == pytest.approx(0.25)


def test_aims_are_met_or_missed():
    assert result(1.5)["aims"] == {"p99_ratio": True, "read_timeouts": True}
    assert result(1.51)["aims"] == {"p99_ratio": False, "read_timeouts": True}
    assert result(1.0, read_timeouts=1)["aims"] == {"p99_ratio": True, "read_timeouts": False}


def test_table_shows_what_was_measured():
    lines = report(result())
    (row,) = [line for line in lines if "above 12 ms" in line]
    assert row.split()[3:] == ["2", "of", "100", "0", "of", "100"]
    (row,) = [line for line in lines if "send interval, max" in line]
    assert row.split()[3:] == ["21.00", "ms", "8.50", "ms"]
    (row,) = [line for line in lines if "setpoint age at the feedback, p50" in line]
    assert row.split()[-2:] == ["3.50", "ms"]
    (row,) = [line for line in lines if "the loop's process" in line]
    assert row.split()[-4:] == ["9.0", "%", "0.7", "%"]


def test_table_shows_which_aim_was_missed():
    def row(word, **changes):
        (line,) = [line for line in report(result(**changes)) if word in line]
        return line

    assert row("ratio of the p99").endswith("met")
    assert row("ratio of the p99", ratio=1.6).endswith("MISSED")
    assert row("read time-outs", read_timeouts=2).endswith("MISSED")


def test_result_is_json_with_finite_numbers():
    assert json.loads(json.dumps(rounded(result()), allow_nan=False)) == rounded(result())


# ---- amount of measurement ----------------------------------------------------------------------


def arguments(*words):
    return make_parser().parse_args(["bench", "arm", *words])


@pytest.mark.parametrize(
    ("words", "pairs", "seconds"),
    [
        ((), 5, 8.0),
        (("--quick",), 2, 2.0),
        (("--pairs", "7", "--seconds", "3.5"), 7, 3.5),
        (("--quick", "--seconds", "1"), 2, 1.0),
    ],
)
def test_number_and_length_of_blocks_are_options(words, pairs, seconds):
    effort = effort_of(arguments(*words))
    assert (effort.pairs, effort.seconds) == (pairs, seconds)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--pairs", "0"), "--pairs 0"),
        (("--seconds", "0.5"), "--seconds 0.5"),
        (("--seconds", "nan"), "--seconds nan"),
        (("--priority", "100"), "--priority 100"),
        (("--priority", "-1"), "--priority -1"),
    ],
)
def test_options_out_of_range_are_refused(words, named):
    with pytest.raises(CommandError, match=named) as refused:
        effort_of(arguments(*words))
    assert refused.value.code == 2


def test_robot_is_complete_and_uses_free_ports():
    tasks = {task.name: list(task.command) for task in bench_arm.robot(arguments())}
    assert set(tasks) == {
        "platform_controller",
        "simulated_drive",
        "path_interpolator",
        "mpc_planner",
        "arm_streamer",
        "simulated_ur",
    }
    values = {}
    for word in tasks["arm_streamer"]:
        name, found, value = word.partition(":=")
        values |= {name: value} if found else {}  # as in ROS, the last value wins
    ports = {values[f"ports.{name}"] for name in ("dashboard", "secondary", "rtde")}
    assert ports == {values[f"ur.{name}_port"] for name in ("dashboard", "script", "rtde")}
    assert len(ports) == 3 and not ports & {"29999", "30002", "30004"}
    assert (values["ur.reverse_port"], values["ur.read_timeout"]) == ("0", "0.04")
    assert values["ur.priority"] == "50"


def test_user_parameter_overrides_that_of_the_benchmark():
    (task,) = [
        task
        for task in bench_arm.robot(arguments("-p", "ur.read_timeout:=0.1"))
        if task.name == "arm_streamer"
    ]
    given = [word for word in task.command if word.startswith("ur.read_timeout")]
    assert given[-1] == "ur.read_timeout:=0.1"


# ---- subscriptions ------------------------------------------------------------------------------


@pytest.fixture
def load(own_domain):
    with Session("bench_arm_test") as session:
        yield Load(session, lambda: None)


def timing(*parts):
    message = Float64MultiArray(data=[value for _, values in parts for value in values])
    message.layout.dim = [
        MultiArrayDimension(label=label, size=len(values)) for label, values in parts
    ]
    return message


@pytest.mark.processes
def test_intervals_and_ages_are_distinguished_by_their_labels(load, monkeypatch):
    monkeypatch.setattr(load, "run", lambda seconds: receive())

    def receive():
        load.on_timing(timing(("intervals", [0.008, 0.009]), ("ages", [0.003])))
        load.on_timing(timing(("ages", [0.004, 0.005]), ("intervals", [0.010])))

    load.on_timing(timing(("intervals", [0.5]), ("ages", [0.5])))
    block = load.measure(1.0)
    assert block == Block((0.008, 0.009, 0.010), (0.003, 0.004, 0.005)), "not what was before"


@pytest.mark.processes
def test_stop_ends_the_benchmark_with_both_reasons(load):
    load.check()
    status = DiagnosticStatus(name="/simulated_ur")
    status.values = [
        KeyValue(key="program_state", value="STOPPED"),
        KeyValue(key="program_end_reason", value="halt"),
    ]
    load.on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name="/other"), status]))
    stop = DiagnosticStatus(name="/arm_streamer", message="stopped: late")
    stop.level = DiagnosticStatus.ERROR
    load.on_stop_state(stop)
    with pytest.raises(CommandError, match=r"/arm_streamer is stopped: late.*STOPPED .halt."):
        load.check()
    stop.level = DiagnosticStatus.OK
    load.on_stop_state(stop)
    load.check()


# ---- the bare loop ------------------------------------------------------------------------------


class Time:
    """A clock that only sleeping advances and that oversleeps in some rounds."""

    def __init__(self, late):
        self.now, self._late, self.rounds = 100.0, late, 0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds + self._late.get(self.rounds, 0.0)
        self.rounds += 1


class Sink:
    def __init__(self):
        self.sizes = []

    def sendall(self, data):
        self.sizes.append(len(data))


def test_bare_loop_keeps_to_absolute_deadlines(monkeypatch):
    monkeypatch.setattr(bench_arm_bare, "time", Time({3: 0.005}))
    out = Sink()
    intervals = bench_arm_bare.block(out, 0.08)
    assert out.sizes == [32] * 11
    assert intervals == pytest.approx([0.008, 0.008, 0.013, 0.003, *[0.008] * 6])


def test_bare_loop_catches_up_after_more_than_a_period(monkeypatch):
    monkeypatch.setattr(bench_arm_bare, "time", Time({2: 0.020}))
    intervals = bench_arm_bare.block(Sink(), 0.08)
    assert intervals == pytest.approx([0.008, 0.028, 0.0, 0.0, 0.004, *[0.008] * 5])


@pytest.mark.processes
def test_bare_loop_reports_the_intervals_of_each_block():
    (port,) = free_ports(1)
    with bench_arm.BareLoop() as bare:
        control = bare._listener.getsockname()[1]
        threading.Thread(target=bench_arm_bare.sink, args=(port,), daemon=True).start()
        loop = threading.Thread(target=bench_arm_bare.loop, args=(port, control, 0), daemon=True)
        loop.start()
        wait_until(bare.is_connected, "the loop")
        for seconds, count in ((0.08, 10), (0.16, 20)):
            bare.begin(seconds)
            found = []
            wait_until(lambda f=found: f.extend(bare.intervals()) or f, "an answer")
            assert len(found) == count and sum(found) > 0.5 * seconds
    loop.join(5.0)
    assert not loop.is_alive(), "it ends with the bench"


@pytest.mark.processes
def test_bare_loop_that_has_ended_raises_an_error():
    with bench_arm.BareLoop() as bare:
        address = bare._listener.getsockname()
        with socket.create_connection(address):
            wait_until(bare.is_connected, "a connection")
        with pytest.raises(CommandError, match="has ended"):
            wait_until(lambda: bare.intervals(), "the end")


# ---- processes ----------------------------------------------------------------------------------


@pytest.mark.processes
def test_child_process_is_found_by_a_word_of_its_command_line():
    idle = "import sys; sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", idle, "r1.word"], stdin=subprocess.PIPE) as child:
        wait_until(lambda: "r1.word" in str(children_of(os.getpid())), "the child")
        assert child_of(os.getpid(), "r1.word") == child.pid
        with pytest.raises(CommandError, match="no child r1"):
            child_of(os.getpid(), "r1")
        with pytest.raises(CommandError, match=r"no child r1\.word"):
            child_of(child.pid, "r1.word")  # a child of another process
        child.stdin.close()


def test_scheduling_class_agrees_with_the_system():
    assert scheduling(os.getpid()) == "SCHED_OTHER"
    with pytest.raises(CommandError, match="999999999"):
        scheduling(999999999)


def finite(value):
    """Return whether all numbers in a structure are finite."""
    if isinstance(value, dict):
        return all(finite(item) for item in value.values())
    if isinstance(value, list):
        return all(finite(item) for item in value)
    return value is not None and (not isinstance(value, float) or math.isfinite(value))


@pytest.mark.exhaustive
@pytest.mark.processes
def test_benchmark_runs_end_to_end_and_publishes_its_json(tmp_path):
    ended = subprocess.run(
        command("bench", "arm", "--quick", *LENIENT, "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    assert found == json.loads((tmp_path / "bench_arm.json").read_text())
    assert finite(found)
    assert (found["quick"], found["pairs"], found["block_s"]) == (True, 2, 2.0)
    assert len(found["pair_ratios"]) == len(found["pair_p99_ms"]) == 2
    assert found["scheduling"]["streamer"] == found["scheduling"]["bare"]
    assert found["bare"]["count"] == 500
    for side in ("streamer", "beside_bare"):
        assert 250 <= found[side]["count"] <= 650
        assert found[side]["age_count"] > 100
    for side in ("streamer", "beside_bare", "bare"):
        figure = found[side]
        assert 0.0 < figure["p50_ms"] <= figure["p99_ms"] <= figure["max_ms"]
        assert figure["above_20_ms"] <= figure["above_12_ms"] <= figure["count"]
    assert all(0.0 < share < 2.0 for share in found["cpu_share"].values())
    assert found["controller"]["read_timeouts"] == 0
    assert found["controller"]["servo_calls"] > 500
    assert found["load"]["goals"] >= 1 and found["load"]["driving_share"] > 0.2
    assert found["load"]["arm_previews"] > 100
    assert set(found["aims"]) == {"p99_ratio", "read_timeouts"}


def descendants(pid):
    found = children_of(pid)
    for child in list(found):
        found |= descendants(child)
    return found


@pytest.mark.exhaustive
@pytest.mark.processes
def test_ctrl_c_ends_all_processes(tmp_path):
    arguments = command("bench", "arm", *LENIENT, "--priority", "0", "--results", str(tmp_path))
    with Running(arguments, environment()) as bench:
        bench.wait_for("pairs of blocks")
        there = descendants(bench.process.pid)
        assert sum("omniman_ros.ur.streaming_loop" in line for line in there.values()) == 1
        assert len(there) == 9, there
        bench.process.send_signal(signal.SIGINT)
        assert bench.finish() == 130
        wait_until(lambda: not any(map(is_alive, there)), "the end of all processes")
    assert not list(tmp_path.iterdir())


@pytest.mark.processes
@pytest.mark.exhaustive
def test_robot_process_that_stops_ends_the_benchmark_with_the_reason(tmp_path):
    elsewhere = environment(0)
    arguments = command("bench", "arm", *LENIENT, "--results", str(tmp_path))
    with Running(arguments, elsewhere) as bench:
        bench.wait_for("pairs of blocks")
        node = next(iter(children_of(bench.process.pid)))
        given = Path(f"/proc/{node}/environ").read_text().split("\0")
        domain = dict(word.split("=", 1) for word in given if word)["ROS_DOMAIN_ID"]
        assert domain != elsewhere["ROS_DOMAIN_ID"], "no other robot may move by the bench"
        subprocess.run(
            command("stop"), env=environment(int(domain)), capture_output=True, timeout=60
        )
        assert bench.finish() == 1
    assert re.search("error: the robot stopped: /[a-z_]+ is stopped: ~/stop", bench.output)
    assert not list(tmp_path.iterdir())
