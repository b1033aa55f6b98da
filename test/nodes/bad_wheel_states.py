"""Messages of `wheel_states` that no node may use."""

from collections.abc import Callable, Sequence

from sensor_msgs.msg import JointState

from test.nodes.harness import World

NAN, INF = float("nan"), float("inf")
GOOD = [0.0] * 4

_CASES: dict[str, tuple[list[float], list[float], float]] = {
    "nan": ([NAN, 0.0, 0.0, 0.0], GOOD, 0.0),
    "infinite speed": (GOOD, [0.0, INF, 0.0, 0.0], 0.0),
    "short": (GOOD[:3], GOOD, 0.0),
    "empty": ([], [], 0.0),
    "wrong name": (GOOD, GOOD, 0.0),
    "name twice": (GOOD, GOOD, 0.0),
    "old": (GOOD, GOOD, -3.0),
    "ahead": (GOOD, GOOD, 1.0),
}  #: Positions, velocities and how far the stamp is ahead [s], by name

CASES = tuple(_CASES)  #: Names of the cases

WRONG_NAMES: dict[str, Callable[[Sequence[str]], list[str]]] = {
    "wrong name": lambda names: ["a", "b", "c", "d"],
    "name twice": lambda names: [names[0]] * 4,
}


def bad_wheel_states(case: str, world: World, names: Sequence[str]) -> JointState:
    """Return the message of a case for four wheels, stamped relative to the present time."""
    position, velocity, ahead = _CASES[case]
    name = WRONG_NAMES[case](names) if case in WRONG_NAMES else list(names)
    message = JointState(name=name, position=position, velocity=velocity)
    message.header.stamp = world.stamp(ahead)
    return message
