"""The controller: programs, stops, pauses and power, on injected time."""

import math

import numpy as np
import pytest

from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.modes import Cb3RobotMode, Cb3RuntimeState, Cb3SafetyMode
from test.simulation.ur.controller_rig import Rig, sweep


@pytest.fixture
def rig():
    return Rig()


def bits(rig):
    return [rig.controller.output(f"{name}_status_bits") for name in ("robot", "safety")]


# ---- servo ------------------------------------------------------------------------------------


def test_servoj_is_called_once_per_cycle_and_the_arm_follows_with_a_lag(rig):
    each, sent = sweep(rig)
    rig.play(each)
    rig.run(2.0)
    assert len(sent) == 250
    assert rig.speed == pytest.approx(0.5, rel=0.01)
    c = rig.controller
    assert sent[-1][0] - c.target.q[0] == pytest.approx(0.5 * 0.03, rel=0.05)
    assert c.target.q[0] - c.arm.q[0] == pytest.approx(0.5 * 0.01, rel=0.05)
    assert c.counts.servo_calls == 250 and c.counts.servo_gaps == 0


@pytest.mark.parametrize("slider", [0.9, 0.7, 0.5, 0.25])
def test_speed_slider_slows_servoj_down(rig, slider):
    rig.controller.slider = slider
    rig.run(1.0)
    each, sent = sweep(rig)
    rig.play(each)
    rig.run(4.0)
    assert len(sent) == pytest.approx(500 * slider, abs=1)
    assert rig.speed == pytest.approx(0.5 * slider, rel=0.03)
    assert rig.controller.output("target_speed_fraction") == pytest.approx(slider)
    assert rig.controller.output("speed_scaling") == 1.0


@pytest.mark.parametrize("how", ["freeze", "end", "silent"])
def test_arm_without_commands_decelerates_to_rest(rig, how):
    silent = []
    each, _ = sweep(rig, 1.0)
    rig.play(lambda host, k: None if silent else each(host, k))
    rig.run(1.0)
    rig.track.clear()
    if how == "freeze":
        rig.faults(freeze_program=True)
    elif how == "end":
        rig.script.end_reason = "completed"
    silent.append(how == "silent")
    rig.run(0.5)
    assert rig.speed < 1e-3
    assert rig.hardest() < 25.0
    assert rig.controller.modes.safety is Cb3SafetyMode.NORMAL
    assert rig.controller.counts.servo_gaps == (how != "end")
    assert rig.controller.end_reason == ("completed" if how == "end" else "")


# ---- protective stop --------------------------------------------------------------------------


def jump(rig, step, gain=300):
    q = rig.start.copy()
    q[0] += step
    rig.play(lambda host, k: host.servoj(tuple(q.tolist()), CYCLE, 0.1, gain))


@pytest.mark.parametrize("step", [0.05, 0.16])
def test_jump_that_a_real_controller_accepts_is_accepted(rig, step):
    jump(rig, step)
    rig.run(1.0)
    assert rig.controller.modes.safety is Cb3SafetyMode.NORMAL
    assert rig.moved == pytest.approx(step, abs=1e-3)


@pytest.mark.parametrize("step", [3.0, -3.0, math.nan, math.inf])
def test_too_large_jump_causes_a_protective_stop_with_deceleration(rig, step):
    jump(rig, step)
    rig.run(1.0)
    c = rig.controller
    assert c.modes.safety is Cb3SafetyMode.PROTECTIVE_STOP
    assert (c.output("safety_mode"), *bits(rig)) == (3, 0b01, 1 << 2 | 1 << 10)
    assert c.runtime is Cb3RuntimeState.PAUSED and c.counts.protective_stops == 1
    assert rig.speed == 0.0 or rig.speed < 1e-3
    assert abs(rig.moved) < 0.5
    assert rig.hardest() <= 40.0 + 1e-6
    assert np.all(np.isfinite(c.arm.q))


def test_joint_at_the_end_of_its_range_causes_a_protective_stop():
    rig = Rig(initial=(6.2, -1.5, 1.0, 0.0, 0.5, 0.0))
    rig.play(sweep(rig, 1.0)[0])
    rig.run(1.0)
    assert rig.controller.modes.safety is Cb3SafetyMode.PROTECTIVE_STOP
    assert "position of joint 0" in rig.controller.log[0]
    assert 6.3355 < rig.controller.arm.q[0] < 6.3355 + 1.0 / 15 + 0.02
    # After unlocking, the joint may be moved back.
    rig.run(5.0)
    assert rig.controller.unlock()
    rig.play(lambda host, k: host.speedj((-0.3, 0, 0, 0, 0, 0), 1.0, CYCLE))
    rig.run(1.0)
    assert rig.controller.modes.safety is Cb3SafetyMode.NORMAL
    assert rig.controller.arm.q[0] < 6.2


def test_manual_protective_stop_stops_within_its_deceleration(rig):
    rig.play(sweep(rig, 2.0)[0])
    rig.run(1.0)
    rig.track.clear()
    rig.faults(protective_stop=True)
    rig.run(2.0 / 15 + 6 * UrArmParameters().lag)
    assert rig.speed < 1e-3
    assert rig.hardest() < 16.0


def test_unlocking_is_refused_for_5_s_and_then_starts_no_motion(rig):
    rig.play(sweep(rig)[0])
    rig.run(1.0)
    rig.faults(protective_stop=True)
    rig.cycle()
    for seconds in (0.0, 2.5, 2.4):
        rig.run(seconds)
        assert not rig.controller.unlock()
        assert not rig.controller.play()
    rig.run(0.2)
    assert rig.controller.unlock()
    where = rig.moved
    rig.run(1.0)
    assert rig.controller.modes.ready and rig.controller.runtime is Cb3RuntimeState.PAUSED
    assert rig.moved == pytest.approx(where, abs=1e-6)
    steps = rig.script.steps
    assert rig.controller.play()
    rig.run(1.0)
    assert rig.controller.runtime is Cb3RuntimeState.PLAYING and rig.script.steps > steps


def test_interrupted_move_continues_after_unlocking(rig):
    goal = rig.start.copy()
    goal[0] += 1.0
    done = []
    rig.play(lambda host, k: done or done.append(host.movej(tuple(goal), 1.0, 0.5, 0.0, 0.0)))
    rig.run(1.0)
    rig.faults(protective_stop=True)
    rig.run(5.5)
    assert not done[0]() and 0.2 < rig.moved < 0.8
    assert rig.controller.unlock() and rig.controller.play()
    rig.track.clear()
    rig.run(4.0)
    assert done[0]() and rig.moved == pytest.approx(1.0, abs=1e-3)
    assert rig.hardest() < 3.0


# ---- pause ------------------------------------------------------------------------------------


def test_pause_slows_down_holds_and_resumes(rig):
    each, sent = sweep(rig)
    rig.play(each)
    rig.run(1.0)
    rig.track.clear()
    rig.faults(pause_program=True)
    rig.cycle()
    assert rig.controller.runtime is Cb3RuntimeState.PAUSING
    rig.run(1.0)
    assert rig.controller.runtime is Cb3RuntimeState.PAUSED and rig.speed < 1e-3
    assert rig.controller.output("speed_scaling") == 0.0
    assert bits(rig) == [0b01, 1]
    count, where = len(sent), rig.moved
    rig.run(1.0)
    assert len(sent) == count and rig.moved == pytest.approx(where, abs=1e-6)
    assert rig.controller.play()
    rig.cycle()
    assert rig.controller.runtime is Cb3RuntimeState.RESUMING
    rig.run(1.5)
    assert rig.controller.runtime is Cb3RuntimeState.PLAYING and len(sent) > count
    assert rig.speed == pytest.approx(0.5, rel=0.02)
    assert rig.hardest() < 8.0
    assert bits(rig) == [0b11, 1]


def test_paused_program_can_be_stopped_exactly_once(rig):
    rig.play(sweep(rig)[0])
    rig.run(0.1)
    assert rig.controller.pause()
    rig.run(1.0)
    assert rig.controller.stop("by hand") and not rig.controller.stop("by hand")
    assert (
        rig.controller.runtime is Cb3RuntimeState.STOPPED
        and rig.controller.end_reason == "by hand"
    )
    assert not rig.controller.play() and not rig.controller.pause()


# ---- emergency stop and power -----------------------------------------------------------------


def test_emergency_stop_ends_the_program_and_removes_power_at_rest(rig):
    rig.play(sweep(rig, 2.0)[0])
    rig.run(1.0)
    rig.track.clear()
    rig.faults(emergency_stop=True)
    rig.cycle()
    c = rig.controller
    assert (c.modes.safety, c.runtime) == (
        Cb3SafetyMode.ROBOT_EMERGENCY_STOP,
        Cb3RuntimeState.STOPPED,
    )
    assert c.end_reason == "emergency stop"
    assert c.modes.robot is Cb3RobotMode.RUNNING and rig.speed > 1.0
    rig.run(0.3)
    assert c.modes.robot is Cb3RobotMode.POWER_OFF and rig.speed == 0.0
    assert rig.hardest() < 16.0
    assert bits(rig) == [0, 1 << 6 | 1 << 7 | 1 << 10]
    assert not c.power(Cb3RobotMode.RUNNING) and not c.start("idle")
    rig.faults()
    rig.run(1.0)
    assert (c.modes.safety, c.modes.robot) == (Cb3SafetyMode.NORMAL, Cb3RobotMode.POWER_OFF)
    assert not c.start("idle")


def test_power_on_is_stepwise_and_brakes_have_a_separate_command(rig):
    c = rig.controller
    assert c.power(Cb3RobotMode.POWER_OFF)
    rig.run(0.1)
    seen = []

    def watch(seconds):
        for _ in range(round(seconds / CYCLE)):
            rig.cycle()
            if not seen or seen[-1] != c.modes.robot.name:
                seen.append(c.modes.robot.name)

    assert c.power(Cb3RobotMode.IDLE)
    watch(2.0)
    assert c.power(Cb3RobotMode.RUNNING)
    watch(2.0)
    assert seen == ["POWER_OFF", "POWER_ON", "IDLE", "RUNNING"]
    assert c.start("idle")
    assert c.output("joint_mode") == (253,) * 6


# ---- programs ---------------------------------------------------------------------------------


def test_new_program_replaces_the_running_one(rig):
    rig.play(sweep(rig)[0])
    first = rig.script
    rig.run(0.1)
    assert rig.controller.start("idle")
    assert first.end_reason == "another program was started"
    assert rig.controller.runtime is Cb3RuntimeState.PLAYING and rig.controller.end_reason == ""


def test_invalid_program_is_rejected_and_the_old_one_continues(rig):
    assert rig.controller.start("idle")
    assert not rig.controller.start("nonsense")
    assert rig.controller.runtime is Cb3RuntimeState.PLAYING
    assert rig.controller.counts.refused == 1 and "nonsense" in rig.controller.log[-1]


def test_arm_is_steady_shortly_after_coming_to_rest(rig):
    rig.play(sweep(rig)[0])
    rig.run(0.5)
    assert not rig.host.is_steady()
    rig.controller.stop("test")
    while rig.speed > 1e-3:
        rig.cycle()
    assert not rig.host.is_steady()
    rig.run(0.2)
    assert rig.host.is_steady()


# ---- registers, outputs -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "kind", "index"),
    [
        ("input_int_register_7", -3, "int", 7),
        ("input_double_register_47", 2.5, "double", 47),
        ("input_bit_register_64", True, "bool", 64),
        ("input_bit_registers32_to_63", 4, "bool", 34),
    ],
)
def test_program_reads_registers_written_by_a_client(rig, name, value, kind, index):
    rig.controller.write_inputs({name: value})
    expected = True if kind == "bool" else value
    assert rig.host.read_register(kind, index) == expected
    assert rig.controller.output(name) == value


@pytest.mark.parametrize(
    ("kind", "index", "value", "name", "read"),
    [
        ("int", 3, -5, "output_int_register_3", -5),
        ("double", 0, 0.5, "output_double_register_0", 0.5),
        ("bool", 64, 1, "output_bit_register_64", True),
        ("int", 0, 1 << 31, "output_int_register_0", -(1 << 31)),
        ("bool", 33, 1, "output_bit_registers32_to_63", 2),
    ],
)
def test_client_reads_registers_written_by_a_program(rig, kind, index, value, name, read):
    rig.host.write_register(kind, index, value)
    assert rig.controller.output(name) == read


def test_digital_outputs_and_the_slider_are_set_by_mask(rig):
    c = rig.controller
    c.write_inputs({"standard_digital_output_mask": 6, "standard_digital_output": 0xFF})
    c.write_inputs({"tool_digital_output_mask": 2, "tool_digital_output": 2})
    c.write_inputs({"standard_digital_output_mask": 2, "standard_digital_output": 0})
    assert c.output("actual_digital_output_bits") == 1 << 2 | 1 << 17
    c.write_inputs({"speed_slider_mask": 0, "speed_slider_fraction": 0.3})
    assert c.slider == 1.0
    c.write_inputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.3})
    assert c.slider == 0.3


def test_every_output_has_a_value_of_its_type(rig):
    from omniman_ros.simulation.ur.rtde_fields import OUTPUTS, codec, flatten

    rig.run(0.1)
    for name, kind in OUTPUTS.items():
        assert codec([kind]).pack(*flatten([rig.controller.output(name)])), name


def test_timestamp_increases_by_a_cycle_and_can_be_offset(rig):
    rig.cycle()
    first = rig.controller.output("timestamp")
    rig.cycle()
    assert rig.controller.output("timestamp") - first == pytest.approx(CYCLE)
    rig.faults(timestamp_offset=-1.0)
    rig.cycle()
    assert rig.controller.output("timestamp") - first == pytest.approx(2 * CYCLE - 1.0)
