import importlib.util
import re
import struct
from unittest.mock import Mock

import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.simulation.ur.urscript import grammar
from omniman_ros.simulation.ur.urscript.compiler import Program
from omniman_ros.simulation.ur.urscript.machine import MAX_WORK
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.reverse_interface import ProgramMode
from omniman_ros.ur.servo_program import servo_program
from omniman_ros.ur.streaming_supervisor import joint_limits
from test.simulation.ur.urscript.driver_script import DRIVER
from test.simulation.ur.urscript.scripted_host import Bench
from test.work import calls

Q = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
READY, DONE = 1, 2  # in output register 0 of ur_rtde
SERVOJ, SPEEDJ, SPEED_STOP, SERVO_STOP, MOVEJ, STOPJ, QUIT = 11, 9, 15, 16, 1, 34, 255


def setpoint(q, mode=1, timeout=40):
    return struct.pack(">8i", timeout, *(round(angle * 1e6) for angle in q), mode)


def driver():
    """The driver's program, connected, its main thread at the first read."""
    bench = Bench(DRIVER).step()
    assert bench.log == ["active"]
    return bench


def test_a_driver_s_first_read_waits_for_ever():
    assert driver().step(1000).machine.running


def test_a_driver_connects_after_some_attempts():
    bench = Bench(DRIVER)
    bench.host.refused = True
    bench.step(2)
    assert not bench.log
    bench.host.refused = False
    assert bench.step(24).log == ["active"]


def test_a_setpoint_is_servoed_to_in_the_cycle_in_which_it_came():
    bench = driver()
    for cycle in range(20):
        q = tuple(angle + 0.01 * cycle for angle in Q)
        bench.host.received["reverse"] += setpoint(q)
        [(kind, found, *rest)] = bench.step().motions
        assert kind == "servoj" and found == pytest.approx(q) and rest == [0.008, 0.03, 1000]


def test_a_missing_setpoint_is_extrapolated():
    bench = driver()
    for scale in (1.0, 1.1):
        bench.host.received["reverse"] += setpoint([scale * angle for angle in Q])
        bench.step()
    _ = bench.motions
    [(_, found, *_)] = bench.step().motions
    assert found == pytest.approx([1.2 * angle for angle in Q])


@pytest.mark.parametrize("cut", range(32))
def test_a_message_cut_at_any_byte_is_read_when_it_is_whole(cut):
    bench = driver()
    data = setpoint(Q)
    bench.host.received["reverse"] += data[:cut]
    assert not bench.step().motions
    bench.host.received["reverse"] += data[cut:]
    assert bench.step().motions[0][1] == pytest.approx(Q)


def test_a_driver_that_hears_nothing_stops_after_the_time_out_that_it_was_told():
    bench = driver()
    bench.host.received["reverse"] += setpoint(Q, timeout=40)
    bench.step()
    assert bench.step(4).machine.running and {m[0] for m in bench.motions} == {"servoj"}
    bench.step()
    assert bench.log == ["timed out"] and bench.motions == [("stopj", 4.0)]
    bench.step()
    assert bench.end == "halt" and bench.host.calls[-1] == ("close", "reverse")


def test_a_driver_that_is_told_to_stop_ends():
    bench = driver()
    bench.host.received["reverse"] += setpoint(Q)
    bench.step(2)
    bench.host.received["reverse"] += setpoint(Q, mode=-2)
    bench.step(3)
    assert bench.motions[-1] == ("stopj", 4.0) and bench.end == "completed"


def omniman_program():
    """The program that this package uploads."""
    return servo_program(
        UrParameters(), joint_limits(ArmParameters(), UrParameters()), "10.0.0.2", 50001
    )


def test_all_setpoints_of_1_6_s_are_read_in_the_cycle_in_which_they_came():
    bench = Bench(omniman_program()).step()
    for cycle in range(200):
        bench.host.received["omniman"] += setpoint([1e-4 * cycle] * 6, ProgramMode.SERVO)
    bench.step()
    assert bench.machine.running and bench.motions[0][1] == pytest.approx([0.0199] * 6)


def test_an_endless_loop_ends_within_a_bounded_number_of_calls():
    bench = Bench("while True:\n  a = sin(1.0) + cos(2.0) * 3.0\nend")
    work = calls(bench.step)
    assert "infinite loop" in bench.end
    assert work < 2 * MAX_WORK


def test_the_parser_compiles_nothing_at_its_first_program(monkeypatch):
    source = importlib.util.find_spec(grammar.__name__)
    fresh = importlib.util.module_from_spec(source)
    source.loader.exec_module(fresh)

    compiler = Mock(wraps=re.compile)
    with monkeypatch.context() as patch:
        patch.setattr(re, "compile", compiler)
        for text in (DRIVER, omniman_program(), "sec f():\n  pass\nend", "movej(p[1, 2], a=-1)"):
            fresh.parse(text)
    assert not compiler.called


def rtde_script():
    """The program of ur_rtde, from where it is installed, with the offsets that it fills in."""
    client = pytest.importorskip("script_client").ScriptClient("127.0.0.1", 3, 15)
    body = client.getScript().replace("= # float", "= 0 # float").replace("= # int", "= 0 # int")
    assert "global reg_offset_int = 0" in body
    return f"def rtde_control():\n{body}\nend\n"


@pytest.fixture(scope="module")
def script():
    return rtde_script()


class RtdeBench(Bench):
    """Plays the registers that the ur_rtde client writes and reads."""

    @property
    def status(self):
        return self.host.outputs.get(("int", 0))

    def command(self, number, *floats, integers=()):
        """Give a command until it is taken, then none until the program is ready again."""
        _ = self.motions
        registers = {("double", at): value for at, value in enumerate(floats)}
        registers |= {("int", 1 + at): value for at, value in enumerate(integers)}
        self.host.inputs = registers | {("int", 0): number}
        self.step()
        return self

    def idle(self, steps=1):
        self.host.inputs["int", 0] = 0
        return self.step(steps)


@pytest.fixture
def rtde(script):
    bench = RtdeBench(script).step(3)
    assert bench.status == READY and bench.machine.running
    return bench


def test_rtde_servoj_repeats_its_target_until_it_is_stopped(rtde):
    rtde.command(SERVOJ, *Q, 0, 0, 0.008, 0.05, 500)
    assert rtde.status == READY
    for scale in (1, 2, 3):
        q = tuple(scale * angle for angle in Q)
        rtde.command(SERVOJ, *q, 0, 0, 0.008, 0.05, 500)
        assert rtde.motions == [("servoj", q, 0.008, 0.05, 500)]
    assert rtde.idle(3).motions == [("servoj", q, 0.008, 0.05, 500)] * 3
    assert rtde.command(SERVO_STOP, 10).motions == [("stopj", 10)]
    assert rtde.step().status == DONE
    assert not rtde.idle(3).motions and rtde.status == READY


def test_rtde_speedj_runs_until_it_is_stopped(rtde):
    rtde.command(SPEEDJ, *Q, 0.5, 0.02)
    rtde.host.cycles["speedj"] = 3
    assert rtde.motions == [("speedj", Q, 0.5, 0.02)]
    assert rtde.idle(4).motions == [("speedj", Q, 0.5, 0.02)] * 2
    assert rtde.command(SPEED_STOP, 8).motions == [("stopj", 8)]
    assert rtde.step().status == DONE and not rtde.idle(3).motions


def test_rtde_movej_is_done_when_the_motion_is(rtde):
    rtde.host.cycles["movej"] = 5
    rtde.command(MOVEJ, *Q, 1.05, 1.4)
    assert rtde.motions == [("movej", Q, 1.4, 1.05, 0, 0)]
    assert rtde.step(4).status == READY
    assert rtde.step().status == DONE
    assert rtde.idle().status == READY


def test_rtde_movej_in_the_background_is_stopped(rtde):
    rtde.host.cycles["movej"] = 100
    rtde.command(MOVEJ, *Q, 1.05, 1.4, integers=[1])
    assert rtde.motions == [("movej", Q, 1.4, 1.05, 0, 0)] and rtde.status == DONE
    rtde.idle(2)
    assert rtde.command(STOPJ, 2).motions == [("stopj", 2)]
    assert rtde.step().status == DONE
    assert "stopping async movement - killing move_thrd" in rtde.log


def test_rtde_script_ends_when_it_is_told(rtde):
    assert rtde.command(QUIT).step().end == "completed"


def test_rtde_commands_that_need_kinematics_name_the_function(rtde):
    assert "function 'movel' is not defined" in rtde.command(3).end


def test_work_of_reading_a_program_grows_with_its_length_and_no_faster():
    line = "  a = sin(1.0) + [b, 2][0] * (3 - c)\n"

    def read(lines):
        return calls(lambda: Program("def f():\n" + line * lines + "end\n"))

    read(1)  # later programs find caches filled
    assert read(200) < 11 * read(20)


def test_a_driver_s_cycle_takes_no_more_work_after_a_thousand_cycles():
    bench = driver()

    def cycle(number):
        bench.host.received["reverse"] += setpoint([1e-4 * number] * 6)
        return calls(bench.step)

    work = [cycle(number) for number in range(1000)]
    assert len(bench.motions) == 1000
    assert max(work[2:]) == min(work[2:]) < MAX_WORK
