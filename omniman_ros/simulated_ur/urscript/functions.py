"""Functions of the controller that a program can call (URScript manual, CB3, by module).

Each takes its thread first; parameter names and defaults are the manual's. A function that waits
returns a Wait. Tool space is not simulated: `stopl` brings the joints to rest with its number as
rad/s^2, and what would need kinematics is not here at all.
"""

from collections.abc import Callable

from omniman_ros.simulated_ur.urscript import calculations, sockets
from omniman_ros.simulated_ur.urscript.host import Done
from omniman_ros.simulated_ur.urscript.instructions import PENDING, Thread, Wait
from omniman_ros.simulated_ur.urscript.values import (
    Value,
    integer,
    joints,
    number,
    to_str,
    truth,
)

STEP_TIME = 0.008  # s, of a cycle
TIMING = 1e-6  # s; a cycle's time may be a sum of many steps

WITHOUT_EFFECT = (
    "end_force_mode",  # modes that are never on
    "end_freedrive_mode",
    "end_teach_mode",
    "force_mode_set_damping",
    "force_mode_set_gain_scaling",
    "enable_external_ft_sensor",  # tool, load and its weight do not show in the joints' motion
    "ft_rtde_input_enable",
    "zero_ftsensor",
    "set_gravity",
    "set_payload",
    "set_target_payload",
    "set_tcp",
)
"""Functions that a simulation of the joints alone can take and ignore, whatever they are given."""


# Motion


def motion(done: Done) -> Wait:
    """Wait until a motion command has ended, at least one cycle."""
    return Wait(lambda: None if done() else PENDING)


def servoj(
    thread: Thread,
    q: Value,
    a: Value = 0,
    v: Value = 0,
    t: Value = STEP_TIME,
    lookahead_time: Value = 0.1,
    gain: Value = 300,
) -> Wait:
    """Servo to joint angles for a time; a and v are not used by the controller either."""
    return motion(
        thread.machine.host.servoj(
            joints(q, "q"),
            number(t, "t"),
            number(lookahead_time, "lookahead_time"),
            number(gain, "gain"),
        )
    )


def speedj(thread: Thread, qd: Value, a: Value = 1.4, t: Value = 0) -> Wait:
    """Accelerate to joint speeds."""
    return motion(thread.machine.host.speedj(joints(qd, "qd"), number(a, "a"), number(t, "t")))


def stopj(thread: Thread, a: Value = 2) -> Wait:
    """Decelerate to rest."""
    return motion(thread.machine.host.stopj(number(a, "a")))


def stopl(thread: Thread, a: Value = 2, aRot: Value = "a") -> Wait:  # noqa: N803
    """Decelerate to rest; here in joint space."""
    return stopj(thread, a)


def movej(
    thread: Thread, q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0, r: Value = 0
) -> Wait:
    """Move to joint angles."""
    numbers = number(a, "a"), number(v, "v"), number(t, "t"), number(r, "r")
    return motion(thread.machine.host.movej(joints(q, "q"), *numbers))


def reading(what: str) -> Callable[[Thread], Value]:
    """A function that gives six values of the arm."""
    return lambda thread: tuple(thread.machine.host.joints(what))


def is_steady(thread: Thread) -> bool:
    """Whether the arm has been at rest for a moment."""
    return thread.machine.host.is_steady()


# Internals


def sync(thread: Thread) -> Wait:
    """Wait for the next cycle."""
    return Wait(lambda: None)


def sleep(thread: Thread, t: Value) -> Wait:
    """Wait for a time, at least one cycle."""
    host = thread.machine.host
    end = host.time + number(t, "t") - TIMING
    return Wait(lambda: None if host.time >= end else PENDING)


def get_steptime(thread: Thread) -> float:
    """Time of a cycle."""
    return STEP_TIME


def textmsg(thread: Thread, s1: Value, s2: Value = "") -> None:
    """Write to the log."""
    thread.machine.host.textmsg(to_str(s1) + to_str(s2))


def popup(
    thread: Thread,
    s: Value,
    title: Value = "Popup",
    warning: Value = False,
    error: Value = False,
    blocking: Value = False,
) -> Wait | None:
    """Show a message; a blocking one waits until it is closed."""
    machine = thread.machine
    machine.host.popup(to_str(s))
    if not truth(blocking):
        return None
    closed = machine.popups_closed
    return Wait(lambda: None if machine.popups_closed > closed else PENDING)


def random(thread: Thread) -> float:
    """A number in [0, 1); seeded."""
    return thread.machine.random.random()


# Registers


def read(kind: str, convert: Callable[[float], Value]) -> Callable[[Thread, Value], Value]:
    """A function that reads an input register."""

    def apply(thread: Thread, address: Value) -> Value:
        return convert(thread.machine.host.read_register(kind, integer(address, "address")))

    return apply


def write(kind: str, convert: Callable[[Value], float]) -> Callable[[Thread, Value, Value], None]:
    """A function that writes an output register."""

    def apply(thread: Thread, address: Value, value: Value) -> None:
        index = integer(address, "address")
        thread.machine.host.write_register(kind, index, convert(value))

    return apply


FUNCTIONS: dict[str, Callable[..., object]] = {
    **{each.__name__: each for each in (
        servoj, speedj, stopj, stopl, movej, is_steady,
        sync, sleep, get_steptime, textmsg, popup, random,
    )},
    **calculations.FUNCTIONS,
    **sockets.FUNCTIONS,
    **dict.fromkeys(WITHOUT_EFFECT, lambda thread, *values, **named: None),
    "get_joint_positions": reading("actual_q"),
    "get_actual_joint_positions": reading("actual_q"),
    "get_target_joint_positions": reading("target_q"),
    "get_actual_joint_speeds": reading("actual_qd"),
    "get_target_joint_speeds": reading("target_qd"),
    "read_input_integer_register": read("int", int),
    "read_input_float_register": read("double", float),
    "read_input_boolean_register": read("bool", bool),
    "write_output_integer_register": write("int", lambda value: integer(value, "value")),
    "write_output_float_register": write("double", lambda value: number(value, "value")),
    "write_output_boolean_register": write("bool", truth),
}  # fmt: skip
