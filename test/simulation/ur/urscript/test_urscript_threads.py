import pytest

from test.simulation.ur.urscript.scripted_host import Bench, fault_of, ran

Q = "[0, 0, 0, 0, 0, 1]"


def test_sync_gives_up_the_time_slice():
    bench = Bench("while True:\n  textmsg(1)\n  sync()\nend")
    for _ in range(3):
        assert bench.step().log == ["1"]


def test_servoj_of_one_cycle_takes_one_cycle():
    bench = Bench(f"while True:\n  servoj({Q}, t=0.008, lookahead_time=0.05, gain=400)\nend")
    for _ in range(3):
        assert bench.step().motions == [("servoj", (0, 0, 0, 0, 0, 1), 0.008, 0.05, 400)]


def test_servoj_has_the_defaults_of_the_manual():
    assert Bench(f"servoj({Q})").step().motions == [
        ("servoj", (0, 0, 0, 0, 0, 1), 0.008, 0.1, 300)
    ]


@pytest.mark.parametrize(
    "statement, kind, arguments",
    [
        (f"servoj({Q}, 0, 0, 0.02)", "servoj", ((0, 0, 0, 0, 0, 1), 0.02, 0.1, 300)),
        (f"speedj({Q}, 40.0, 0.008)", "speedj", ((0, 0, 0, 0, 0, 1), 40, 0.008)),
        (f"speedj({Q}, a=2)", "speedj", ((0, 0, 0, 0, 0, 1), 2, 0)),
        (f"movej({Q}, v=2, a=3, r=0.1)", "movej", ((0, 0, 0, 0, 0, 1), 3, 2, 0, 0.1)),
        (f"movej({Q})", "movej", ((0, 0, 0, 0, 0, 1), 1.4, 1.05, 0, 0)),
        ("stopj(4)", "stopj", (4,)),
        ("stopl(5)", "stopj", (5,)),
    ],
)
def test_a_motion_command_holds_its_thread_until_it_is_done(statement, kind, arguments):
    bench = Bench(f'{statement}\ntextmsg("done")')
    bench.host.cycles[kind] = 3
    bench.step(3)
    assert bench.motions == [(kind, *arguments)] and not bench.log
    assert bench.step().log == ["done"]


@pytest.mark.parametrize("time, cycles", [(0.008, 1), (0.02, 3), (0.024, 3), (0.08, 10), (0, 1)])
def test_sleep_takes_whole_cycles_and_at_least_one(time, cycles):
    bench = Bench(f'sleep({time})\ntextmsg("awake")').step(cycles)
    assert not bench.log
    assert bench.step().log == ["awake"]


@pytest.mark.parametrize("start", range(30, 60))
def test_sleep_takes_the_same_cycles_at_any_time(start):
    bench = Bench('sleep(0.024)\ntextmsg("awake")')
    bench.host.ticks = start
    assert not bench.step(3).log
    assert bench.step().log == ["awake"]


def test_threads_run_in_each_cycle_after_the_main_one_in_the_order_in_which_they_started():
    text = """
thread a():
  while True:
    textmsg("a")
    sync()
  end
end
thread b():
  while True:
    textmsg("b")
    sync()
  end
end
run b()
run a()
while True:
  textmsg("main")
  sync()
end
"""
    bench = Bench(text)
    for _ in range(3):
        assert bench.step().log == ["main", "b", "a"]


def test_a_motion_holds_only_its_own_thread():
    bench = Bench(f"""
thread mover():
  movej({Q})
  textmsg("moved")
end
run mover()
while True:
  textmsg("main")
  sync()
end
""")
    bench.host.cycles["movej"] = 2
    assert [bench.step().log for _ in range(3)] == [["main"], ["main"], ["main", "moved"]]


def test_threads_share_the_globals_and_have_variables_of_their_own():
    text = """
shared = 0
thread t():
  own = 5
  shared = shared + own
  sync()
  global made = own
end
run t()
run t()
sync()
sync()
"""
    assert ran(text, 4).machine.variables == {"shared": 10, "made": 5}


def test_join_waits_without_taking_a_cycle():
    text = """
thread t():
  sync()
  textmsg("t")
end
h = run t()
join h
textmsg("joined")
"""
    bench = Bench(text)
    assert bench.step().log == []
    assert bench.step().log == ["t", "joined"] and bench.end == "completed"


def test_joins_of_threads_that_end_together_are_over_in_one_cycle():
    text = """
thread t():
  sync()
end
thread u():
  join a
  textmsg("u")
end
a = run t()
b = run u()
join b
join a
join 0
textmsg("main")
"""
    bench = Bench(text).step()
    assert bench.step().log == ["u", "main"]


def test_kill_ends_a_thread_and_its_motion_is_not_repeated():
    text = f"""
thread t():
  while True:
    servoj({Q})
  end
end
h = run t()
sync()
sync()
kill h
kill h
kill 0
sync()
textmsg("end")
"""
    bench = Bench(text)
    assert len(bench.step(2).motions) == 2
    assert not bench.step().motions
    assert bench.step().log == ["end"]


def test_a_thread_can_kill_itself():
    text = """
thread t():
  kill h
  textmsg("never")
end
global h = 0
h = run t()
join h
textmsg("main")
"""
    bench = Bench(text)
    assert bench.step().log == ["main"]


def test_handles_are_numbers_other_than_zero():
    text = """
thread t():
  sync()
end
a = run t()
b = run t()
if a != 0 and b != 0 and a != b:
  textmsg(1)
end
"""
    assert ran(text).log == ["1"]


@pytest.mark.parametrize(
    "statement, reason", [("sync()", ""), ("halt", "halt"), ("", "completed")]
)
def test_the_end_of_the_main_thread_or_halt_ends_all_threads(statement, reason):
    text = f"""
thread t():
  while True:
    textmsg("t")
    sync()
  end
end
run t()
sync()
{statement}
"""
    bench = Bench(text).step(2)
    assert bench.end == reason and bench.machine.running == (not reason)
    assert bench.log == (["t"] if reason else ["t", "t"])
    assert not bench.step(2).log


def test_halt_in_a_thread_ends_the_program():
    assert ran("thread t():\n  halt\nend\nrun t()\nwhile True:\n  sync()\nend").end == "halt"


def test_a_runtime_error_in_a_thread_ends_the_program():
    assert fault_of("thread t():\n  a = 1 / 0\nend\nrun t()\nsync()") == (2, "division by zero")


def test_stop_ends_the_program_once():
    bench = Bench("while True:\n  sync()\nend").step()
    bench.machine.stop("stopped")
    bench.machine.stop("again")
    assert bench.end == "stopped" and not bench.machine.running


def test_an_endless_loop_is_a_runtime_error_in_the_main_thread_and_in_others():
    assert fault_of("while True:\nend") == (1, "infinite loop")
    text = "thread t():\n  while True:\n    pass\n  end\nend\nrun t()\nsync()"
    line, message = fault_of(text)
    assert message == "infinite loop" and 2 <= line <= 4


def test_a_long_loop_that_ends_is_none():
    text = "i = 0\nwhile i < 1000:\n  i = i + 1\nend"
    assert ran(text).end == "completed"


def test_each_cycle_has_the_whole_allowance():
    text = "while True:\n  i = 0\n  while i < 50:\n    i = i + 1\n  end\n  sync()\nend"
    bench = Bench(text, max_work=600).step(20)
    assert bench.machine.running


def test_threads_without_end_are_a_runtime_error():
    for body in ("run t()\n  sync()\n  run t()\n  sync()", "run t()"):
        bench = Bench(f"thread t():\n  {body}\nend\nrun t()\nwhile True:\n  sync()\nend").step(20)
        assert "threads" in bench.end


def test_threads_that_pile_up_are_a_runtime_error():
    text = "thread t():\n  sleep(60)\nend\nwhile True:\n  run t()\n  sync()\nend"
    bench = Bench(text).step(63)
    assert bench.machine.running
    assert bench.step().end.startswith("runtime error line 5: more than 64 threads")


def test_threads_that_have_ended_do_not_count():
    text = "thread t():\nend\nwhile True:\n  run t()\n  sync()\nend"
    assert Bench(text).step(200).machine.running


def test_starting_and_joining_without_end_is_an_infinite_loop():
    text = "thread t():\nend\nwhile True:\n  h = run t()\n  join h\nend"
    assert ran(text).end.startswith("runtime error line 4")


def test_a_wait_in_a_critical_section_lets_others_run():
    text = """
flag = 0
thread t():
  enter_critical
  sync()
  flag = 1
  exit_critical
end
h = run t()
enter_critical
join h
exit_critical
textmsg(flag)
"""
    assert ran(text, 3).log == ["1"]


def test_a_wait_may_stand_in_the_middle_of_an_expression():
    text = "def f(x):\n  sync()\n  return x\nend\na = [1, f(2) + f(3), 4]"
    bench = Bench(text).step(2)
    assert bench.machine.running
    assert bench.step().machine.variables == {"a": (1, 5, 4)}
