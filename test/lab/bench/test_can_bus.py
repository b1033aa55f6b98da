import json
import math
import subprocess

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.lab.bench import can_bus as bench_can
from omniman_ros.lab.bench import can_faults
from omniman_ros.lab.bench.can_bus import Side, aims, report, robot_of
from omniman_ros.lab.bench.can_faults import (
    FAULTS,
    REST_TIME,
    Record,
    time_of_evidence,
    time_of_reaction,
    time_of_rest,
)
from omniman_ros.lab.bench.can_rig import DIALECTS, BusFrame, load_installation
from test.running import command, environment

SIDE = {"median_ms": 1.0, "p99_ms": 2.0, "lost_share": 0.25, "cpu_share": 0.5}
CASE = {
    "wheels": 4,
    "rate_hz": 250.0,
    "bridge": SIDE | {"median_ms": 1.5},
    "same_drives": SIDE,
    "echo": SIDE,
    "ratio_same_drives": 1.5,
    "ratio": 1.5,
    "frames_per_period": 13.0,
    "load": {"500000": 0.8, "1000000": 0.4},
}
ROW = {
    "fault": "drive silent",
    "runs": 5,
    "reaction_median_ms": 19.0,
    "reaction_max_ms": 21.0,
    "bound_ms": 22.0,
    "late": 0,
    "rest_median_ms": 250.0,
    "rest_max_ms": 260.0,
    "repeated": 0,
    "moved_before_reset": 0,
}
EMCY = bytes.fromhex("10 23 03 00 00 00 00 00")
"""Error code 0x2310, current at the output (CiA 301, 7.2.7): little-endian."""
TARGET = bytes.fromhex("0F 00 10 27 00 00 09")
QUICK_STOP = bytes.fromhex("02 00 00 00 00 00 09")


def result(case=None, row=None):
    return {"cases": [CASE | (case or {})], "faults": {"cia402": [ROW | (row or {})]}}


def text(**changes):
    return "\n".join(report(result(**changes)))


# ---- round trips --------------------------------------------------------------------------------


@pytest.mark.parametrize("wheels", [4, 8])
def test_robot_with_more_wheels_is_complete(wheels):
    robot = robot_of(wheels)
    assert len(robot.wheels.names) == len(set(robot.wheels.names)) == wheels
    assert len(set(zip(robot.wheels.x, robot.wheels.y, strict=True))) == wheels
    inverse = PlatformKinematics(robot.wheels).J
    assert inverse.shape == (wheels, 3)
    assert np.linalg.matrix_rank(inverse) == 3


def test_figures_of_a_side_are_milliseconds_and_fractions():
    side = Side(trips=[0.001, 0.002, 0.003], lost=1, periods=4, cpu=0.5, wall=2.0)
    summary = side.summary()
    assert summary["median_ms"] == pytest.approx(2.0)
    assert (summary["lost_share"], summary["cpu_share"]) == (0.25, 0.25)
    assert math.isnan(Side().summary()["median_ms"])


def test_aims_are_met_or_missed():
    assert aims(result()) == {"latency_ratio": True, "reactions": True}
    assert not aims(result(case={"ratio": 2.01}))["latency_ratio"]
    for worse in ({"late": 1}, {"moved_before_reset": 1}, {"runs": 0}):
        assert aims(result(row=worse)) == {"latency_ratio": True, "reactions": False}


def test_tables_show_what_was_measured():
    said = text()
    assert "4 at 250 Hz" in said and "1.50 / 2.00 ms" in said and "80 % / 40 %" in said
    (row,) = [line for line in said.splitlines() if "cia402: drive silent" in line]
    assert row.split()[3:] == [
        *("19.0", "ms"),
        *("21.0", "ms"),
        *("22", "ms"),
        *("250", "ms"),
        *("260", "ms"),
        "5",
    ]


def test_table_shows_repeated_runs_and_motion_before_a_reset():
    assert "MOVED AGAIN" in text(row={"moved_before_reset": 1})
    assert "3 (+2 stopped by something else)" in text(row={"runs": 3, "repeated": 2})
    unmeasured = {key: ROW[key] for key in ("fault", "moved_before_reset")}
    faults = {"vesc": [unmeasured | {"runs": 0, "repeated": 6}]}
    assert "0 (+6" in "\n".join(can_faults.report(faults))


# ---- reactions ----------------------------------------------------------------------------------


def cia402(kind):
    return DIALECTS["cia402"].kinds[kind]


def test_reaction_is_that_of_the_last_drive():
    frames = [BusFrame(0.001 * k, 0x200 + node, QUICK_STOP) for k, node in enumerate((1, 2, 1, 3))]

    def is_reaction(frame, node):
        return frame.id == 0x200 + node and frame.data[:2] == b"\x02\x00"

    assert time_of_reaction(frames, 0.0, (1, 2, 3), is_reaction) == 0.003
    assert time_of_reaction(frames, 0.0, (1, 2), is_reaction) == 0.001, "of each the first counts"
    assert time_of_reaction(frames, 0.0015, (1,), is_reaction) == 0.002, (
        "not what was before the fault"
    )
    assert time_of_reaction(frames, 0.0, (1, 2, 3, 4), is_reaction) is None


def test_evidence_is_the_first_matching_frame_or_the_last_before_silence():
    frames = [BusFrame(0.01 * k, 0x281, bytes(8)) for k in range(10)]
    report_of = cia402("report")
    assert time_of_evidence(frames, report_of, (1,), True, (0.015, 0.055)) == 0.02
    assert time_of_evidence(frames, report_of, (1,), False, (0.015, 0.055)) == 0.05
    assert time_of_evidence(frames, report_of, (2,), False, (0.0, 1.0)) is None


def test_rest_begins_when_the_platform_remains_at_rest():
    truth = [(0.01 * k, 5.0 if k < 10 or k == 12 else 0.5) for k in range(100)]
    assert time_of_rest(truth, 0.0) == pytest.approx(0.13)
    assert time_of_rest(truth, 0.5) == pytest.approx(0.5)
    assert time_of_rest(truth[: 13 + int(REST_TIME / 0.01) - 2], 0.0) is None, (
        "not for long enough yet"
    )
    assert time_of_rest(truth[:12], 0.0) is None
    assert time_of_rest([], 0.0) is None


@pytest.mark.parametrize(
    ("protocol", "kind", "id", "data", "shown"),
    [
        ("cia402", "EMCY", 0x081, EMCY, True),
        ("cia402", "EMCY", 0x081, bytes(8), False),  # code 0: the error is cleared
        ("cia402", "EMCY", 0x080, b"", False),  # SYNC
        ("cia402", "watchdog", 0x081, EMCY, False),
        ("cia402", "watchdog", 0x081, bytes.fromhex("30 81 11 00 00 00 00 00"), True),
        ("cia402", "boot-up", 0x701, b"\x00", True),
        ("cia402", "boot-up", 0x701, b"\x05", False),
        ("cia402", "other mode", 0x181, bytes.fromhex("37 06 09 00 00"), False),
        ("cia402", "other mode", 0x181, bytes.fromhex("37 06 01 00 00"), True),
        ("cia402", "whole report", 0x281, bytes(7), False),
        ("vesc", "report", 0x0901, bytes(8), True),
        ("vesc", "report", 0x1B01, bytes(8), True),
        ("vesc", "setpoint", 0x0301, bytes(4), True),
        ("odrive", "error", 0x021, bytes.fromhex("00 00 00 00 08 00 00 00"), False),
        ("odrive", "error", 0x021, bytes.fromhex("20 00 00 00 01 00 00 00"), True),
        ("odrive", "watchdog", 0x021, bytes.fromhex("00 00 00 01 01 00 00 00"), True),
        ("odrive", "report", 0x029, bytes(8), True),
        ("odrive", "report", 0x049, bytes(8), False),  # from node 2
    ],
)
def test_frames_that_show_a_fault_are_distinguished_from_others(protocol, kind, id, data, shown):
    assert DIALECTS[protocol].kinds[kind](BusFrame(0.0, id, data), 1) is shown


@pytest.mark.parametrize(
    ("protocol", "name", "bound"),
    [
        ("cia402", "drive fault (EMCY)", 0.005 + 0.002),
        ("cia402", "drive silent", 3 * 0.005 + 0.005 + 0.002),
        ("cia402", "commands end", 0.1 + 0.005 + 0.002),
        ("vesc", "emergency_stop", 0.01 + 0.002),
        ("vesc", "drive silent", 3 * 0.01 + 0.01 + 0.002),
        ("odrive", "drive silent", 3 * 0.005 + 0.005 + 0.002),
    ],
)
def test_bounds_are_those_of_the_installation(protocol, name, bound):
    (fault,) = [fault for fault in FAULTS[protocol] if fault.name == name]
    assert fault.bound(load_installation(protocol)) == pytest.approx(bound)


def test_evidence_and_reaction_of_every_fault_exist_in_its_protocol():
    for protocol, faults in FAULTS.items():
        assert len({fault.name for fault in faults}) == len(faults) >= 4
        kinds = {*DIALECTS[protocol].kinds, "stop", "change", "watchdog", "foreign", ""}
        assert {kind for fault in faults for kind in (fault.evidence, fault.reaction)} <= kinds


def test_record_counts_late_reactions():
    record = Record(reactions=[0.004, 0.006, 0.008], rests=[0.2, 0.3, 0.4], repeated=1)
    (fault,) = [fault for fault in FAULTS["cia402"] if fault.name == "~/stop"]
    summary = record.summary(fault, 0.007, reacts=True)
    assert summary["reaction_median_ms"] == pytest.approx(6.0)
    assert (summary["late"], summary["runs"], summary["repeated"]) == (1, 3, 1)
    assert summary["rest_max_ms"] == pytest.approx(400.0)
    assert "bound_ms" not in record.summary(fault, 0.007, reacts=False)
    assert Record().summary(fault, 0.007, reacts=True)["runs"] == 0


# ---- as a command -------------------------------------------------------------------------------


def finite(value):
    """Return whether a structure contains numbers, all of them finite."""
    if isinstance(value, dict):
        return all(finite(item) for item in value.values())
    if isinstance(value, list):
        return bool(value) and all(finite(item) for item in value)
    return value is not None and (not isinstance(value, float) or math.isfinite(value))


@pytest.mark.exhaustive
@pytest.mark.processes
def test_benchmark_runs_end_to_end_and_publishes_its_json(tmp_path):
    ended = subprocess.run(
        command("bench", "can", "--quick", "--results", str(tmp_path)),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    said = json.loads(ended.stdout.splitlines()[-1])
    assert said == json.loads((tmp_path / "bench_can.json").read_text())
    assert said["quick"] is True
    assert [(case["wheels"], case["rate_hz"]) for case in said["cases"]] == [
        (wheels, rate) for wheels in bench_can.WHEELS for rate in bench_can.RATES
    ]
    assert finite(said["cases"][0]) and finite(said["faults"])
    for case in said["cases"]:
        assert case["load"]["500000"] == pytest.approx(2.0 * case["load"]["1000000"], rel=0.01)
        assert case["frames_per_period"] > 3.0 * case["wheels"]
    measured = {
        name: [row for row in rows if row["runs"]] for name, rows in said["faults"].items()
    }
    assert set(measured) == {"cia402", "vesc", "odrive"}
    assert len(measured["cia402"]) > 5, "a busy machine stops the drives by itself, not always"
    for row in measured["cia402"]:
        assert 0.0 < row["reaction_median_ms"] <= row["reaction_max_ms"]
        assert row["rest_max_ms"] > row["reaction_median_ms"]
        assert row["moved_before_reset"] == 0
