import random
import re
import tracemalloc

import pytest

from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.simulation.ur.urscript import compiler
from omniman_ros.simulation.ur.urscript.compiler import Program
from omniman_ros.simulation.ur.urscript.errors import ScriptError
from test.simulation.ur.urscript.driver_script import DRIVER
from test.simulation.ur.urscript.scripted_host import Bench, fault_of, ran
from test.work import calls

FUZZES = 100


@pytest.mark.parametrize(
    "text, line, reason",
    [
        ("", 1, "not one program"),
        ("# only words\n", 1, "not one program"),
        ("def f():\nend\ndef g():\nend\n", 1, "not one program"),
        ("def f(a):\nend\n", 1, "not one program"),
        ("thread t():\nend\n", 1, "not one program"),
        ("def f():\n  a = 1\n", 3, "unexpected end of text"),
        ("a = 1\nend\n", 2, "unexpected 'end'"),
        ("if True\n  a = 1\nend", 1, "unexpected newline"),
        ("a = \nb = 2", 1, "unexpected newline"),
        ("a = 1 2", 1, "unexpected '2'"),
        ("a = (1\nb = 2\n", 2, "unexpected 'b'"),
        ("\n\na = [1, 2", 3, "unexpected end of text"),
        ("f(", 1, "unexpected end of text"),
        ('a = "x\n', 1, "string does not end"),
        ("\na = 1 ? 2", 2, "unexpected character '?'"),
        ("a = 1 & 2", 1, "unexpected character '&'"),
        ("a = 2147483648", 1, "32 bits"),
        ("a = " + "9" * 5000, 1, "32 bits"),
        ("a = p[1, 2, 3]", 1, "a pose has 6 elements, not 3"),
        ("1 + 2", 1, "neither a call nor an assignment"),
        ("a", 1, "neither a call nor an assignment"),
        ("f()[0]", 1, "neither a call nor an assignment"),
        ("x = 1\nbreak", 2, "break outside a loop"),
        ("while x:\nend\nbreak", 3, "break outside a loop"),
        ("while True:\n  def f():\n    continue\n  end\nend", 3, "continue outside a loop"),
        ("def f(a, a):\nend\nf(1)", 1, "parameter 'a' stands there twice"),
        ("thread t(a):\nend\nrun t(1)", 1, "cannot have parameters"),
        ("f(a=1, 2)", 1, "positional argument behind one by name"),
        ("global 1 = 2", 1, "unexpected '1'"),
        ("else:", 1, "unexpected 'else'"),
        ("a[0][1] = 2", 1, "neither a call nor an assignment"),
        ("(x) = 1", 1, "neither a call nor an assignment"),
        ("True = 1", 1, "neither a call nor an assignment"),
        ("[] = 1", 1, "neither a call nor an assignment"),
        ("f() = 1", 1, "neither a call nor an assignment"),
        ("(x)[0] = 1", 1, "neither a call nor an assignment"),
        ("(x[0]) = 1", 1, "neither a call nor an assignment"),
        ("a = (p)[1, 2, 3, 4, 5, 6]", 1, "unexpected ','"),
        ("pass", 1, "not one program"),
        ("if = 1", 1, "unexpected '='"),
        ("a = " + "f(" * 500 + ")" * 500, 1, "nested more than"),
        ("a = " + "-" * 500 + "1", 1, "nested more than"),
        ("a = " + "not " * 500 + "True", 1, "nested more than"),
        ("a = " + "[" * 500 + "]" * 500, 1, "nested more than"),
        ("a = " + "p[" * 500 + "1" + "]" * 500, 1, "nested more than"),
        ("if True:\n" * 500 + "end\n" * 500, 40, "nested more than"),
        ("def f():\n" * 600 + "end\n" * 600, 39, "nested more than"),
        ("a = " + "(" * 3000 + "1" + ")" * 3000, 1, "nested more than"),
        ("a = " + "(1 or 1 xor 1 and 1 == 1 + 1 * " * 38 + "1" + ")" * 38, 1, "nested more than"),
        ("def f():\n" * 20 + "if True:\n" * 20 + "end\n" * 40, 40, "nested more than"),
        ("while True:\n" * 21 + "end\n" * 21, 21, "loops are nested more than 20 deep"),
    ],
)
def test_what_is_no_program_is_refused_with_its_line(text, line, reason):
    with pytest.raises(ScriptError) as caught:
        Program(text)
    assert caught.value.line == line
    assert reason in str(caught.value) and str(caught.value).startswith(f"line {line}: ")
    assert isinstance(caught.value, OmnimanError)


@pytest.mark.parametrize(
    "word", ["(", "[", "f(", "a[", "-", "not ", "-(", "def f():\n", "if a:\n"]
)
def test_depth_is_refused_where_it_begins_however_long_the_text_is(word):
    def refuse(times):
        with pytest.raises(ScriptError, match=r"^line (1|39|40): nested more than 40 deep$"):
            Program(word * times if "\n" in word else "a = " + word * times)

    refuse(100)  # later programs find caches filled
    assert calls(lambda: refuse(100_000)) == calls(lambda: refuse(100))


def test_what_is_nested_less_deep_is_a_program():
    for text in (
        "a = " + "(" * 37 + "1" + ")" * 37,
        "a = " + "(1 + " * 18 + "1" + ")" * 18,
        "if True:\n" * 38 + "a = 1\n" + "end\n" * 38,
        "while True:\n" * 20 + "return 1\n" + "end\n" * 20,
        "def f():\n" * 38 + "a = 1\n" + "end\n" * 38 + "f()",
    ):
        assert Bench(text).step().end == "completed"


def test_long_chains_are_not_deep():
    text = "a = 1" + " + 1" * 1000 + "\nif a == 0:\n" + "elif a == 0:\n" * 1000 + "end\n"
    assert Bench(text).step().machine.variables["a"] == 1001


def test_long_chains_keep_only_their_last_result():
    def peak(operators):
        bench = Bench(f"b = [{', '.join(['1.5'] * 100)}]\na = b" + " + b" * operators)
        tracemalloc.start()
        assert bench.step().end == "completed"
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(1)
    assert peak(500) < 2 * peak(10)


@pytest.mark.parametrize(
    "statement, reason",
    [
        ("b = missing", "name 'missing' is not defined"),
        ("missing[0] = 1", "name 'missing' is not defined"),
        ("movel([0,0,0,0,0,0])", "function 'movel' is not defined"),
        ("run missing()", "thread 'missing' is not defined"),
        ("run sync()", "thread 'sync' is not defined"),
        ("run f(1, 2)", "'f' is no thread"),
        ("t()", "'t' is a thread: run it"),
        ("f(1)", "'f' takes other arguments: ['x', 'y']"),
        ("f(1, 2, 3)", "'f' takes other arguments: ['x', 'y']"),
        ("f(1, x=2)", "'f' takes other arguments: ['x', 'y']"),
        ("f(1, y=2, y=3)", "'f' takes other arguments: ['x', 'y']"),
        ("f(1, z=2)", "'f' takes other arguments: ['x', 'y']"),
        ("servoj()", "'servoj': missing a required argument: 'q'"),
        ("sync(1)", "'sync': too many positional arguments"),
        ("servoj(a, gain=1, gain=2)", "'servoj': an argument stands there twice"),
        ("servoj(a, gains=1)", "'servoj': got an unexpected keyword argument 'gains'"),
        ("servoj(a)", "q has 2 elements, not 6"),
        ("servoj(p[0,0,0,0,0,0])", "q is a pose: inverse kinematics are not simulated"),
        ('movej([0,0,0,0,0,"a"])', "q is no number but string a"),
        ("movej([0,0,0,0,0,0], a=True)", "a is no number but bool True"),
        ("b = 1 / 0", "division by zero"),
        ("b = 1 % 0", "division by zero"),
        ("b = 1.5 % 0.0", "division by zero"),
        ("b = 2147483647 + 1", "an integer overflows its 32 bits"),
        ("b = 65536 * 65536", "an integer overflows its 32 bits"),
        ("b = sqrt(-1)", "math domain error"),
        ("b = pow(10, 400)", "math range error"),
        ("b = floor(1e300)", "an integer overflows its 32 bits"),
        ("b = True + 1", "'+' is not for bool and int"),
        ('b = "a" + 1', "'+' is not for string and int"),
        ("b = a * a", "'*' is not for list and list"),
        ("b = a + 1", "'+' is not for list and int"),
        ("b = 1 / a", "'/' is not for int and list"),
        ("b = a + [1]", "'+' of lists of 2 and 1 elements"),
        ("b = a < 1", "'<' is not for list and int"),
        ('b = -"x"', "'*' is not for int and string"),
        ("b = textmsg(1) + 1", "'+' is not for none and int"),
        ("b = a[2]", "index 2 is out of range of a list of 2"),
        ("b = a[-1]", "index -1 is out of range of a list of 2"),
        ("b = a[1.0]", "an index is no int but float 1"),
        ("b = 1[0]", "what is indexed is no list but int 1"),
        ("a[2] = 1", "index 2 is out of range of a list of 2"),
        ("a[0] = [[1]]", "lists are nested more than two deep"),
        ("b = [textmsg(1)]", "an element has no value"),
        (f"b = [{'1, ' * 101}]", "a list has more than 100 scalars"),
        (f"b = [[{'1, ' * 50}], [{'1, ' * 50}], 1]", "a list has more than 100 scalars"),
        ("b = p[0,0,0,0,0,a]", "an element of a pose is no number but list [1, 2]"),
        ("if a:\nend", "a condition is no bool but list [1, 2]"),
        ('while "x":\nend', "a condition is no bool but string x"),
        ("b = not a", "a condition is no bool but list [1, 2]"),
        ("b = True and a", "a condition is no bool but list [1, 2]"),
        ("kill True", "True is no thread"),
        ("join a", "[1, 2] is no thread"),
        ('b = to_num("x")', "'x' is no number"),
        (f'b = to_num("{"9" * 400}")', f"'{'9' * 400}' is no number"),
        ('b = str_at("x", 1)', "index 1 is out of range of a string of 1"),
        ('sleep("x")', "t is no number but string x"),
        ("write_output_integer_register(0, 0.5)", "value is no whole number but 0.5"),
        ("write_output_integer_register(0, 1e999)", "value is no whole number but inf"),
        ("g()", "calls are nested more than 200 deep at 'g'"),
    ],
)
def test_what_cannot_be_executed_is_a_runtime_error_with_its_line(statement, reason):
    before = "a = [1, 2]\ndef f(x, y):\nend\nthread t():\nend\ndef g(): g() end\n\n"
    line, message = fault_of(before + statement)
    assert message == reason
    assert line == (6 if statement == "g()" else 8)


def test_names_that_python_reserves_are_names_of_arguments():
    assert ran("set_tcp(p[0,0,0,0,0,0], __debug__=1, None=2, class=3)").end == "completed"


def test_what_python_cannot_translate_is_refused_with_its_line(monkeypatch):
    monkeypatch.setattr(compiler, "MAX_LOOPS", 30)  # Python has 20
    with pytest.raises(ScriptError, match=r"^line 2\d: .*too many statically nested blocks"):
        Program("while True:\n" * 25 + "end\n" * 25)


@pytest.mark.parametrize("kind", [OverflowError, ValueError, TypeError])
def test_a_calculation_that_fails_is_a_runtime_error_with_its_line(kind):
    bench = Bench("\nis_steady()")

    def fail():
        raise kind("no result")

    bench.host.is_steady = fail
    assert bench.step().end == "runtime error line 2: no result"


def test_unknown_functions_may_be_mentioned():
    assert ran("if False:\n  movel(1)\n  run nothing()\n  servoj()\nend").end == "completed"


def test_a_string_that_grows_without_end_is_a_runtime_error():
    text = 's = "x"\nwhile True:\n  s = s + s\nend'
    assert fault_of(text) == (3, "a string has more than 4096 characters")


@pytest.mark.parametrize(
    "loop",
    [
        "while True:\n  a = 1" + " + 1" * 500 + "\nend",
        "while 1" + " + 1" * 500 + " > 0:\nend",
        "while True:\n  if 1" + " + 1" * 500 + " > 0:\n  end\nend",
        "def f(a=1" + " + 1" * 500 + "):\nend\nwhile True:\n  f()\nend",
        f"b = [{'1, ' * 100}]\nwhile True:\n  b = b + b - b\nend",
        f"b = [{'1, ' * 100}]\nwhile True:\n  b = -b\nend",
        f"b = [[{'1, ' * 50}], [{'1, ' * 50}]]\nwhile True:\n  b = b + b - b\nend",
        f"b = [{'1, ' * 100}]\nwhile True:\n  c = norm(b)\nend",
    ],
)
def test_an_endless_loop_ends_within_its_work_whatever_its_statements_are(loop):
    bench = Bench(loop, max_work=10_000)
    work = calls(bench.step)
    assert bench.end.endswith("infinite loop")
    assert work < 30 * 10_000


def test_calls_without_a_statement_are_counted():
    chain = [f"def f{k}(a = f{k + 1}() == f{k + 1}()):\nend" for k in range(40)]
    text = "\n".join([*chain, "def f40():\nend", "f0()"])
    assert Bench(text, max_work=3000).step().end.endswith(": infinite loop")


def test_a_wait_that_fails_is_a_runtime_error_of_the_line_that_waits():
    text = 'socket_open("h", 1, "s")\ndef f():\n  socket_read_line("s", 0)\nend\na = 1 + f()\n'
    bench = Bench(text).step()
    bench.host.received["s"] = b"x" * 4097 + b"\n"
    assert bench.step().end == "runtime error line 3: a string has more than 4096 characters"


def test_what_the_controller_refuses_is_a_runtime_error():
    bench = Bench("\nread_input_float_register(99)")

    def refuse(kind, index):
        raise InputError(f"no register {index}")

    bench.host.read_register = refuse
    assert bench.step().end == "runtime error line 2: no register 99"


def outcome(text):
    """Run for some cycles whatever parses; why it ended, or the ScriptError."""
    try:
        program = Program(text)
    except ScriptError as error:
        assert 1 <= error.line <= text.count("\n") + text.count("\r") + 2
        return error
    assert program.main
    return Bench(text, max_work=3000).step(3).end


def test_a_program_cut_at_any_byte_is_refused():
    whole = DRIVER.rstrip()
    Program(whole)
    for cut in range(0, len(whole), 23):  # all of them: 23 times the time
        assert isinstance(outcome(whole[:cut]), ScriptError), cut


WORDS = re.findall(
    r"\S+|\n",
    """def thread end if elif else while run join kill global local halt return break and or not
    True ( ) [ ] , : = == + - * / % p[ a[ a b c servo_q 1 2.5 "s" $ # @ 0x 1e \0 \\ é ' "
    sync() servoj(a) textmsg( read_q( sleep(0.1) socket_read_byte_list(1)
    """,
)


def test_garbage_is_refused_or_runs_and_nothing_else():
    chance = random.Random(7)
    kinds = set()
    for _ in range(FUZZES):
        text = " ".join(chance.choices(WORDS, k=chance.randint(1, 30)))
        kinds.add(type(outcome(text)))
    assert kinds == {ScriptError, str}


def test_programs_with_changes_are_refused_or_run_and_nothing_else():
    chance = random.Random(8)
    lines = DRIVER.split("\n")
    ends = set()
    for _ in range(FUZZES):
        changed = list(lines)
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(changed))
            words = changed[at].split(" ")
            words[chance.randrange(len(words))] = chance.choice(WORDS)
            changed[at] = " ".join(words)
        ends.add(str(outcome("\n".join(changed))).partition(":")[0])
    assert any(end.startswith("line") for end in ends)
    assert any(end.startswith("runtime error") for end in ends)


def test_bytes_of_any_kind_are_refused_or_run():
    chance = random.Random(9)
    kinds = set()
    for _ in range(FUZZES):
        kinds.add(type(outcome(chance.randbytes(chance.randint(0, 6)).decode("latin-1"))))
    assert ScriptError in kinds
