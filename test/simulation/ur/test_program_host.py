"""Programs on the controller itself: what their calls may ask of it."""

import inspect

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.simulation.ur.arm import SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.controller_server import launcher
from omniman_ros.simulation.ur.port_clients import state_of
from omniman_ros.simulation.ur.program_sockets import ProgramSockets
from omniman_ros.simulation.ur.script_protocol import robot_state
from omniman_ros.simulation.ur.urscript.errors import ScriptRuntimeError
from omniman_ros.simulation.ur.urscript.functions import FUNCTIONS
from test.simulation.ur.controller_rig import Rig

ZERO = (0.0,) * 6
FAR = (1e308, *ZERO[1:])


@pytest.mark.parametrize(
    ("call", "arguments", "reason"),
    [
        ("movej", (FAR, 1.0, 1.0, 0.0, 0.0), "a joint value"),
        ("movej", (ZERO, 1e308, 1.0, 0.0, 0.0), "an acceleration or speed"),
        ("movej", (ZERO, 1.0, 1e308, 0.0, 0.0), "an acceleration or speed"),
        ("movej", (ZERO, 1.0, 1.0, 1e-300, 0.0), "a time"),
        ("movej", (ZERO, 1.0, 1.0, 1e308, 0.0), "a time"),
        ("movej", (ZERO, 1.0, 1.0, -1.0, 0.0), "a time"),
        ("speedj", (FAR, 1.0, 0.0), "a joint value"),
        ("speedj", (ZERO, 1e308, 0.0), "an acceleration or speed"),
        ("speedj", (ZERO, 1.0, 1e308), "a time"),
        ("speedj", (ZERO, 1.0, -1.0), "a time"),
        ("stopj", (1e308,), "an acceleration or speed"),
        ("servoj", (ZERO, 1e308, 0.1, 300.0), "a time"),
        ("servoj", (ZERO, float("nan"), 0.1, 300.0), "a time"),
        ("servoj", (ZERO, 0.008, 0.02, 300.0), "a lookahead time"),
        ("servoj", (ZERO, 0.008, 0.21, 300.0), "a lookahead time"),
        ("servoj", (ZERO, 0.008, 0.1, 99.0), "a gain"),
        ("servoj", (ZERO, 0.008, 0.1, 2001.0), "a gain"),
    ],
)
def test_motion_command_out_of_bounds_is_refused(call, arguments, reason):
    with pytest.raises(ScriptRuntimeError, match=f"^{reason} must be "):
        getattr(Rig().host, call)(*arguments)


NUMBERS = ["0", "1", "-1", "0.03", "300", "1e308", "-1e308", "1e-300", "1e999", "1e999 * 0"]
OTHERS = ["2147483647", "-2147483647", "True", "[]", "[1, [2, 3]]", "p[0, 0, 0, 0, 0, 1e308]"]
STRINGS = ['""', '"a\0b"', '"é"', '"%s"' % ("9" * 400), '"%s"' % ("9" * 4000), '"-1e999"']

numbers = st.sampled_from(NUMBERS)
strings = st.sampled_from(STRINGS)
joints = numbers.map(lambda each: f"[{each}, 0, 0, 0, 0, 0]")
anything = st.one_of(numbers, joints, st.sampled_from(OTHERS), strings)
#: What parameters take that are checked before the others are used; those not here take anything
TYPED = {
    **dict.fromkeys(("q", "qd"), joints),
    **dict.fromkeys(("a", "v", "t", "r", "lookahead_time", "gain", "port"), numbers),
    **dict.fromkeys(("address", "socket_name"), strings),
}


@st.composite
def call(draw, name):
    """A call of a function of the controller, with arguments for each of its parameters."""
    parameters = [*inspect.signature(FUNCTIONS[name]).parameters.values()][1:]
    arguments = [
        f"{each.name}={draw(TYPED.get(each.name, anything))}"
        for each in parameters
        if each.kind is each.POSITIONAL_OR_KEYWORD
        and (each.default is each.empty or draw(st.booleans()))
    ]
    return f"{name}({', '.join(arguments)})"


def controller_of(network=None):
    """A controller without ports that runs programs in URScript."""
    parameters = UrArmParameters()
    launch = launcher(network or ProgramSockets())
    return Cb3Controller(parameters, SimulatedArm(parameters), launch)


@pytest.mark.parametrize(
    ("text", "is_secondary"),
    [
        ("second = 1\nwhile second:\n  sync()\nend\n", False),
        ("section()\n", False),
        ("sec s():\n  x = 1\nend\n", True),
        ("# a comment\nsec s():\n  x = 1\nend\n", True),
    ],
)
def test_only_a_secondary_program_leaves_the_running_one_alone(text, is_secondary):
    controller = controller_of()
    assert controller.start("while True:\n  sync()\nend\n") and controller.start(text)
    assert controller.counts.programs == 2 - is_secondary


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
@settings(max_examples=30)
@given(data=st.data())
def test_no_call_ends_the_controller(name, data):
    text = f"{data.draw(call(name))}\nsync()\n"
    network = ProgramSockets()
    controller = controller_of(network)
    assert controller.start(text), controller.log
    for cycle in range(4):
        controller.cycle(0.008 * cycle)
        assert robot_state(state_of(controller))
    network.close_all()
