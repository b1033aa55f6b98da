import math

import pytest

from omniman_ros.simulation.ur.urscript.values import Pose
from test.simulation.ur.urscript.scripted_host import Bench, fault_of, ran, value_of


@pytest.mark.parametrize(
    "expression, value",
    [
        ("1 + 2 - 3", 0),
        ("4 * 5 / 6", 20 / 6),
        ("(1 + 2) * 3 / (4 - 5)", -9.0),
        ("2 - 3 - 4", -5),
        ("2 + 3 * 4", 14),
        ("-2 + 3", 1),
        ("2 * -3", -6),
        ("- -3", 3),
        ("7 % 4", 3),
        ("-7 % 4", -3),
        ("7.5 % 2", 1.5),
        ("3 / 2", 1.5),
        ("0x1F", 31),
        ("1e-3", 0.001),
        (".5 + 1. + 2.5E1", 26.5),
        ("2147483647", 2**31 - 1),
        ("+4", 4),
    ],
)
def test_arithmetic(expression, value):
    found = value_of(expression)
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize(
    "expression, value",
    [
        ("True or False and (1 == 2)", True),
        ("(True or False) and (1 == 2)", False),
        ("1 > 2 or 3 != 4 xor 5 < -6", True),
        ("not 42 >= 87 and 87 <= 42", False),
        ("not (42 >= 87 and 87 <= 42)", True),
        ("not not True", True),
        ("True xor True", False),
        ("True xor False", True),
        ("1 < 1", False),
        ("1 <= 1", True),
        ("1 > 1", False),
        ("1 >= 1", True),
        ("[1, 2] == [1, 2]", True),
        ("[1, 2] != [1, 2]", False),
        ('"a" == "a"', True),
        ('"a" == 1', False),
        ("1 == 1.0", True),
        ("False and missing()", False),
        ("True or missing()", True),
        ("0 and True", False),
        ("2 or False", True),
        ("True and 2", True),
        ("False or 0", False),
        ("1 == 2 == not 3 == 4", False),
        ("False == not 1 + 2 == 3", True),
        ("not True == not True", True),
    ],
)
def test_conditions(expression, value):
    assert value_of(expression) is value


@pytest.mark.parametrize(
    "expression, value",
    [
        ("[1, 2] + [3, 4.5]", (4, 6.5)),
        ("[1, 2] - [3, 4]", (-2, -2)),
        ("[1, 2] * 3", (3, 6)),
        ("-3 * [1, 2]", (-3, -6)),
        ("[1, 2] / 4", (0.25, 0.5)),
        ("-[1, 2]", (-1, -2)),
        ("[[1, 2], [3, 4]] * 2", ((2, 4), (6, 8))),
        ("[[1, 2], [3, 4]][1][0]", 3),
        ('[True, "a", 1.5][1]', "a"),
        ("[]", ()),
        ("p[1, 2, 3, 4, 5, 6]", Pose((1, 2, 3, 4, 5, 6))),
        ("p[1, 2, 3, 4, 5, 6][5]", 6.0),
        ("\"Hello\" + ', World!'", "Hello, World!"),
        ('"# no comment"', "# no comment"),
    ],
)
def test_lists_poses_and_strings(expression, value):
    found = value_of(expression)
    assert found == value and type(found) is type(value)


def test_not_may_stand_before_any_operand():
    for expression in ("1 + not True", "1 * not True", "1 - 2 * not not True"):
        assert "' is not for int and bool" in fault_of(f"x = {expression}")[1]
    assert fault_of("x = -not True")[1] == "'*' is not for int and bool"
    assert value_of("(not 1 == 2) == (not (1 == 2))") is True


def test_a_call_in_parentheses_is_a_statement():
    assert ran("((textmsg(1)))\n(f(\n))\ndef f(): textmsg(2) end").log == ["1", "2"]


def test_brackets_carry_an_expression_over_lines():
    assert value_of("str_cat(\n  1, # one\n\n  [2,\n3])") == "1[2, 3]"


def test_an_operator_carries_an_expression_over_lines():
    text = "if 1 == 2 or # this\n\n  2 == 2 or\n  3 == 4:\n  a = 1 +\n 1\nend"
    assert ran(text).machine.variables == {"a": 2}
    assert fault_of('a = 1 +\n2 -\n"x"')[0] == 2


def test_labels_annotations_and_comments_are_no_statements():
    text = "def f():\n$ 1 \"Robot Program\"\n  @note x y\n# if\n  a = 1 # = 2\n\t$ 2 'b'\nend\n"
    assert ran(text).machine.variables == {"a": 1}


def test_lines_may_end_as_on_any_system():
    assert ran("a = 1\r\nb = 2\rc = 3\nd = 4").machine.variables == {
        **{"a": 1, "b": 2},
        **{"c": 3, "d": 4},
    }


@pytest.mark.parametrize("x, taken", [(1, "if"), (2, "elif 2"), (3, "elif 3"), (4, "else")])
def test_one_branch_is_taken(x, taken):
    text = f"""
x = {x}
if x == 1:
  textmsg("if")
elif x == 2:
  textmsg("elif 2")
    elif x == 3:
  textmsg("elif 3")
else:
  textmsg("else")
end
if x == 0:
elif x == 9:
  # nothing
end
"""
    assert ran(text).log == [taken]


def test_break_and_continue_are_of_the_innermost_loop():
    text = """
i = 0
while i < 4:
  i = i + 1
  if i == 2:
    continue
  end
  j = 0
  while True:
    j = j + 1
    if j == 3:
      break
    end
  end
  textmsg(i, j)
end
while False:
  textmsg("never")
end
"""
    assert ran(text).log == ["13", "33", "43"]


def test_statements_may_stand_on_one_line():
    assert (
        value_of("a", "a = 0\nwhile a < 3: a = a + 1 end\nif a == 3: a = 7 else: a = 8 end") == 7
    )


def test_functions_take_arguments_by_position_and_by_name_and_have_defaults():
    before = "def f(a, b=2, c=[1, -1]):\n  return [a, b, c[1]]\nend"
    assert value_of("f(5)", before) == (5, 2, -1)
    assert value_of("f(5, 6)", before) == (5, 6, -1)
    assert value_of("f(c=[0, 9], a=5)", before) == (5, 2, 9)


def test_a_default_is_evaluated_at_each_call():
    assert value_of("[f(), f()]", "n = 1\ndef f(a=n):\n  n = n + 1\n  return a\nend") == (1, 2)


def test_arguments_are_evaluated_once_and_in_order():
    text = "def f(a):\n  textmsg(a)\n  return a\nend\ndef g(b, a):\n  return [b, a]\nend\n"
    bench = ran(text + "r = g(a=f(1), b=f(2))")
    assert bench.log == ["1", "2"] and bench.machine.variables["r"] == (2, 1)


def test_functions_call_those_below_them_and_themselves():
    before = """
def even(n):
  if n == 0:
    return True
  end
  return odd(n - 1)
end
def odd(n):
  return n != 0 and even(n - 1)
end
"""
    assert value_of("[even(10), odd(10)]", before) == (True, False)


def test_a_function_without_return_gives_none():
    assert value_of("f()", "def f():\n  return\nend") is None


def test_nested_functions_belong_to_their_function():
    text = """
def f():
  def g():
    return 1
  end
  return g()
end
def g():
  return 2
end
a = [f(), g()]
"""
    assert ran(text).machine.variables["a"] == (1, 2)
    assert fault_of("def f():\n def g():\n end\nend\nf()\ng()")[0] == 6


def test_a_function_of_the_program_hides_that_of_the_controller():
    assert value_of("sin(1)", "def sin(x):\n  return 5\nend") == 5


def test_lists_are_copied_when_assigned_and_passed():
    text = """
def change(l):
  l[0] = 9
  return l
end
a = [1, 2]
b = a
b[1] = 5
c = change(a)
"""
    assert ran(text).machine.variables == {"a": (1, 2), "b": (1, 5), "c": (9, 2)}


def test_a_variable_p_is_indexed_and_assigned_to():
    text = "def f(p):\n  p[0] = p[0] * 2 + p[(1)]\n  return p\nend\nq = f(p[1,2,3,4,5,6])"
    assert ran(text).machine.variables["q"] == Pose((4, 2, 3, 4, 5, 6))
    assert isinstance(ran(text).machine.variables["q"], Pose)


def test_variables_of_the_first_level_are_global_and_functions_assign_to_them():
    text = """
def prog():
  local a = 0
  b = 0
  def f():
    a = 1
    b = a + 1
  end
  f()
end
"""
    assert ran(text).machine.variables == {"a": 1, "b": 2}


def test_an_element_of_a_global_list_is_assigned_in_a_function():
    text = "a = [1, 2]\ndef f():\n  a[0] = 5\nend\nf()"
    assert ran(text).machine.variables == {"a": (5, 2)}


def test_an_unknown_variable_of_a_function_is_its_own():
    text = "def f():\n  a = 1\nend\nf()\nb = a"
    assert fault_of(text) == (5, "name 'a' is not defined")


def test_local_hides_a_global_variable():
    text = "a = 0\ndef f():\n  local a = 1\n  a = a + 1\n  return a\nend\nb = f()"
    assert ran(text).machine.variables == {"a": 0, "b": 2}


def test_global_declares_a_global_variable_in_a_function():
    assert ran("def f():\n  global a = 3\nend\nf()").machine.variables == {"a": 3}


def test_a_nested_function_sees_the_globals_but_not_the_locals_around_it():
    text = """
def prog():
  global a = 0
  def f():
    local a = 1
    def g():
      a = 2
    end
    g()
    return a
  end
  b = f()
end
"""
    assert ran(text).machine.variables == {"a": 2, "b": 1}


def test_parameters_hide_globals():
    text = "a = 0\ndef f(a):\n  a = 5\nend\nf(1)"
    assert ran(text).machine.variables == {"a": 0}


def test_each_call_has_variables_of_its_own():
    text = "def f(n):\n  m = n\n  if n > 0:\n    f(n - 1)\n  end\n  return m\nend\na = f(3)"
    assert ran(text).machine.variables["a"] == 3


def test_one_definition_is_a_program_and_so_is_one_statement():
    assert ran('def f():\n  textmsg("in")\nend\n').log == ["in"]
    assert ran('pass\ndef f():\n  textmsg("in")\nend\nexit_critical\n').log == ["in"]
    assert Bench("movej([0,0,0,0,0,0.5], a=1, v=2)\n").step().motions == [
        ("movej", (0, 0, 0, 0, 0, 0.5), 1, 2, 0, 0)
    ]


def test_words_after_return_and_halt_are_not_executed():
    assert ran(
        "def f():\n  return 1\n  textmsg(1)\nend\nf()\ntextmsg(2)\nreturn\ntextmsg(3)"
    ).log == ["2"]
    bench = ran("def f():\n  halt\nend\nf()\ntextmsg(1)")
    assert bench.end == "halt" and not bench.log


@pytest.mark.parametrize("text", ["halt", "halt()"])
def test_halt_ends_the_program(text):
    assert ran(text).end == "halt"


def test_a_secondary_program_may_not_take_time():
    assert ran("sec f():\n  textmsg(1)\nend").end == "completed"
    assert fault_of("sec f():\n  sleep(1)\nend") == (2, "a secondary program cannot take time")
    assert value_of("sec", "sec = 4") == 4


@pytest.mark.parametrize(
    "expression, value",
    [
        ("sin(1)", math.sin(1)),
        ("cos(1)", math.cos(1)),
        ("tan(1)", math.tan(1)),
        ("asin(0.5)", math.asin(0.5)),
        ("acos(0.5)", math.acos(0.5)),
        ("atan(2)", math.atan(2)),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("sqrt(2)", math.sqrt(2)),
        ("pow(2, 3)", 8.0),
        ("log(10, 1000)", math.log(1000, 10)),
        ("floor(-1.5)", -2),
        ("ceil(-1.5)", -1),
        ("d2r(180)", math.pi),
        ("r2d(3.141592653589793)", 180.0),
        ("norm([3, 4])", 5.0),
        ("norm(-2)", 2),
        ("norm(-2.5)", 2.5),
        ("length([1, 2, 3])", 3),
        ("get_list_length([1, 2])", 2),
        ('length("ab")', 2),
        ("to_str(1.5)", "1.5"),
        ("to_str([1, True, p[0, 0, 0, 0, 0, 0.5]])", "[1, True, p[0, 0, 0, 0, 0, 0.5]]"),
        ('str_cat("a", 0.25)', "a0.25"),
        ('str_len("abc")', 3),
        ('str_empty("")', True),
        ('str_at("abc", 1)', "b"),
        ('str_sub("abcd", 1, 2)', "bc"),
        ('str_sub("abcd", 2)', "cd"),
        ('str_find("abcabc", "c", 3)', 5),
        ('str_find("abc", "x")', -1),
        ('to_num("42")', 42),
        ('to_num("-1.5e1")', -15.0),
        ("integer_to_binary_list(6)[2]", True),
        ("length(integer_to_binary_list(6))", 32),
        ("binary_list_to_integer(integer_to_binary_list(-5))", -5),
        ("get_steptime()", 0.008),
        ("get_actual_joint_positions()", (0.0,) * 6),
        ("get_target_joint_positions()", (1.0,) * 6),
        ("get_actual_joint_speeds()", (2.0,) * 6),
        ("get_target_joint_speeds()", (3.0,) * 6),
        ("get_joint_positions()", (0.0,) * 6),
        ("is_steady()", True),
    ],
)
def test_functions_of_the_controller(expression, value):
    found = value_of(expression)
    assert found == pytest.approx(value) if isinstance(value, float) else found == value
    assert type(found) is type(value)


def test_random_numbers_are_seeded():
    draws = [
        Bench("a = [random(), random()]", seed=seed).step().machine.variables["a"]
        for seed in (1, 1, 2)
    ]
    assert draws[0] == draws[1] != draws[2]
    assert all(0 <= draw < 1 for draw in draws[0]) and draws[0][0] != draws[0][1]


def test_registers_are_read_and_written_by_kind():
    bench = Bench("""
write_output_integer_register(1, read_input_integer_register(24) + 1)
write_output_float_register(2, read_input_float_register(3) * 2)
write_output_boolean_register(4, not read_input_boolean_register(5))
a = read_input_integer_register(24)
""")
    bench.host.inputs = {("int", 24): 6.0, ("double", 3): 1.25, ("bool", 5): 1}
    bench.step()
    assert bench.host.outputs == {("int", 1): 7, ("double", 2): 2.5, ("bool", 4): False}
    assert type(bench.machine.variables["a"]) is int


def test_functions_without_effect_take_what_they_are_given():
    text = (
        "set_payload(1.5, [0, 0, 0])\nset_tcp(p[0,0,0,0,0,0])\nend_force_mode()\nzero_ftsensor()"
    )
    assert ran(text).end == "completed"


def test_a_blocking_popup_holds_its_thread_until_it_is_closed():
    bench = Bench('popup("a", title="b", error=True)\npopup("c", blocking=True)\ntextmsg("d")')
    bench.step(5)
    assert bench.host.popups == ["a", "c"] and bench.machine.running
    bench.machine.close_popups()
    assert bench.step().log == ["d"]
