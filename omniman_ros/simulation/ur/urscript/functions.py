"""Functions of the controller that a program can call (URScript manual, CB3, by module).

The first parameter of each is the context of the program; the names and defaults of the others
are the manual's. A function whose caller has to wait returns a Wait. Tool space is not simulated:
`stopl` decelerates the joints with its number in rad/s^2, and functions that require kinematics
are missing.
"""

from collections.abc import Callable

from omniman_ros.simulation.ur.urscript import calculations, sockets
from omniman_ros.simulation.ur.urscript.context import PENDING, Context, Wait
from omniman_ros.simulation.ur.urscript.host import Done
from omniman_ros.simulation.ur.urscript.values import Value, integer, joints, number, to_str, truth

STEP_TIME = 0.008  #: Time of a cycle [s]
TIMING = 1e-6  #: Tolerance of a time [s], which may be a sum of many cycles

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
)  #: Functions that are accepted with any arguments, and have no effect in this simulation


# Motion


def motion(done: Done) -> Wait:
    """Wait until a motion command has ended, at least one cycle."""
    return Wait(lambda: None if done() else PENDING)


def servoj(
    context: Context,
    q: Value,
    a: Value = 0,
    v: Value = 0,
    t: Value = STEP_TIME,
    lookahead_time: Value = 0.1,
    gain: Value = 300,
) -> Wait:
    """Servo to joint angles for a time; a and v are not used by the controller either."""
    return motion(
        context.host.servoj(
            joints(q, "q"),
            number(t, "t"),
            number(lookahead_time, "lookahead_time"),
            number(gain, "gain"),
        )
    )


def speedj(context: Context, qd: Value, a: Value = 1.4, t: Value = 0) -> Wait:
    """Accelerate to joint speeds."""
    return motion(context.host.speedj(joints(qd, "qd"), number(a, "a"), number(t, "t")))


def stopj(context: Context, a: Value = 2) -> Wait:
    """Decelerate to rest."""
    return motion(context.host.stopj(number(a, "a")))


def stopl(context: Context, a: Value = 2, aRot: Value = "a") -> Wait:  # noqa: N803  (manual)
    """Decelerate to rest; here in joint space."""
    return stopj(context, a)


def movej(
    context: Context, q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0, r: Value = 0
) -> Wait:
    """Move to joint angles."""
    numbers = number(a, "a"), number(v, "v"), number(t, "t"), number(r, "r")
    return motion(context.host.movej(joints(q, "q"), *numbers))


def reading(what: str) -> Callable[[Context], Value]:
    """Return a function that returns six values of the arm."""
    return lambda context: tuple(context.host.joints(what))


def is_steady(context: Context) -> bool:
    """Return whether the arm has been at rest for a moment."""
    return context.host.is_steady()


# Internals


def sync(context: Context) -> Wait:
    """Wait for the next cycle."""
    return Wait(lambda: None)


def sleep(context: Context, t: Value) -> Wait:
    """Wait for a time, at least one cycle."""
    host = context.host
    end = host.time + number(t, "t") - TIMING
    return Wait(lambda: None if host.time >= end else PENDING)


def get_steptime(context: Context) -> float:
    """Return the time of a cycle [s]."""
    return STEP_TIME


def textmsg(context: Context, s1: Value, s2: Value = "") -> None:
    """Write to the log."""
    context.host.textmsg(to_str(s1) + to_str(s2))


def popup(
    context: Context,
    s: Value,
    title: Value = "Popup",
    warning: Value = False,
    error: Value = False,
    blocking: Value = False,
) -> Wait | None:
    """Show a message; a blocking one waits until it is closed."""
    context.host.popup(to_str(s))
    if not truth(blocking):
        return None
    closed = context.popups_closed
    return Wait(lambda: None if context.popups_closed > closed else PENDING)


def random(context: Context) -> float:
    """Return a pseudo-random number in [0, 1)."""
    return context.random.random()


# Registers


def read(kind: str, convert: Callable[[float], Value]) -> Callable[[Context, Value], Value]:
    """Return a function that reads an input register."""

    def apply(context: Context, address: Value) -> Value:
        return convert(context.host.read_register(kind, integer(address, "address")))

    return apply


def write(kind: str, convert: Callable[[Value], float]) -> Callable[[Context, Value, Value], None]:
    """Return a function that writes an output register."""

    def apply(context: Context, address: Value, value: Value) -> None:
        index = integer(address, "address")
        context.host.write_register(kind, index, convert(value))

    return apply


FUNCTIONS: dict[str, Callable[..., object]] = {
    **{
        function.__name__: function
        for function in (
            *(servoj, speedj, stopj, stopl, movej, is_steady),
            *(sync, sleep, get_steptime, textmsg, popup, random),
        )
    },
    **calculations.FUNCTIONS,
    **sockets.FUNCTIONS,
    **dict.fromkeys(WITHOUT_EFFECT, lambda context, *values, **named: None),
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
}  #: All functions of the controller, by name
