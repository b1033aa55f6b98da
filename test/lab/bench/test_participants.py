import json
import subprocess
import threading
import time

import pytest

from omniman_ros.lab.bench.participants import Gaps, aims, report, scheduled
from test.running import command, environment


def result(blocked, stops):
    shared = {"longest_gap": 3.0, "longest_silence": 0.7, "silences": 4, "waited": 0.6}
    default = {"blocked": 2.0, "stops": {"/a": "silent"}, **shared}
    lean = {"blocked": blocked, "stops": stops, **shared}
    return {"runs": {"default": default, "UDP only": lean}}


@pytest.mark.parametrize(
    ("blocked", "stops", "met"),
    [(0.1, {}, (True, True)), (0.11, {}, (False, True)), (0.0, {"/a": "late"}, (True, False))],
)
def test_aims_are_those_without_shared_memory_and_printed(blocked, stops, met):
    measured = result(blocked, stops)
    measured["aims"] = aims(measured)
    assert measured["aims"] == dict(zip(("blocked", "no_stop"), met, strict=True))
    text = "\n".join(report(measured))
    assert text.count("MISSED") == met.count(False)
    assert "2000 ms" in text and "/a: silent" in text and "700 ms" in text


def test_gaps_are_counted_from_the_first_message_on_and_forgotten():
    gaps = Gaps(0.2)
    for stamp in (100.0, 100.1, 100.3001, 100.8, 100.9):
        gaps.add(stamp)
    assert gaps.longest == pytest.approx(0.4999) and gaps.count == 2
    gaps.clear()
    assert (gaps.longest, gaps.count) == (0.0, 0)
    gaps.add(101.0)
    assert gaps.longest == pytest.approx(0.1) and gaps.count == 0


def test_the_kernel_accounts_for_a_thread_that_runs_but_not_for_one_that_is_blocked():
    before = scheduled()
    end = time.thread_time() + 0.02
    while time.thread_time() < end:
        pass
    assert scheduled() - before >= 0.015
    begin, before = time.monotonic(), scheduled()
    threading.Event().wait(0.05)
    assert time.monotonic() - begin - (scheduled() - before) >= 0.04


@pytest.mark.processes
@pytest.mark.exhaustive
def test_benchmark_drives_with_and_without_shared_memory(tmp_path):
    ended = subprocess.run(
        command("bench", "participants", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    measured = json.loads((tmp_path / "bench_participants.json").read_text())
    assert list(measured["runs"]) == ["default", "UDP only"]
    assert all(run["longest_gap"] > 0.0 for run in measured["runs"].values())
