"""Workarounds for defects of rclpy, and access to parts of it without a public interface.

All of them are for rclpy 7.1, the version of ROS 2 Jazzy.
"""

import functools
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage

#: Error of the middleware about data. rclpy 7.1 raises it, but does not export it
RMWError = rclpy_implementation.RMWError
#: Error of the middleware. rclpy 7.1 raises it, but exports it in its implementation only
RCLError = rclpy_implementation.RCLError
#: Error about ROS arguments. rclpy 7.1 raises it, but exports it in its implementation only
UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError

#: Callback of a lifecycle node for one of its transitions, as a function of the node
TransitionCallback = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def parameter_overrides(node: Node) -> dict[str, Parameter]:
    """Return the parameters given on the command line and in files, declared or not.

    rclpy 7.1 keeps them in a private attribute, and ignores undeclared ones silently. A change of
    the dictionary changes what the node declares.
    """
    overrides: dict[str, Parameter] = node._parameter_overrides
    return overrides


def nanoseconds(clock: Clock) -> int:
    """Return the time of a clock [ns].

    `clock.now()` of rclpy 7.1 takes several times as long: it imports, and makes an object.
    """
    return int(clock.handle.get_now().nanoseconds)


def take_timers(node: Node) -> list[Timer]:
    """Take a node's timers away from its executor, and return them.

    The timers of rclpy 7.1's EventsExecutor do not follow jumps of ROS time, and its plain
    executor takes three times the CPU time. On simulated time, nodes call their timers themselves.
    """
    timers: list[Timer] = list(node.timers)
    node._timers.clear()
    return timers


def subscribe_to_clock(
    node: Node, callback: Callable[[ClockMessage], None], depth: int
) -> Subscription:
    """Have a node with `use_sim_time` follow /clock; its clock is set before `callback` is called.

    rclpy 7.1 keeps the last message only. A node that lags behind would read the newest time
    before it has read the other messages of the times that it skips.
    """
    source = node._time_source
    assert source._clock_sub is not None
    node.destroy_subscription(source._clock_sub)

    def receive(message: ClockMessage) -> None:
        source.clock_callback(message)
        callback(message)

    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches any
    source._clock_sub = node.create_subscription(ClockMessage, "/clock", receive, qos)
    return source._clock_sub


def spin_for(executor: Executor, seconds: float) -> None:
    """Serve callbacks for some seconds.

    In rclpy 7.1 EventsExecutor.spin() hangs without a timeout; a future that never completes
    gives it one.
    """
    executor.spin_until_future_complete(rclpy.Future(), timeout_sec=seconds)


@dataclass(frozen=True)
class MessageOrigin:
    """What the middleware tells of a message."""

    sent: int  #: Time at which it was sent, in nanoseconds of the sending host's system clock
    #: Its number among the messages of its publisher, from 1 on; None if the middleware does not
    #: count them.
    number: int | None


def subscribe_with_origin(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[Any, MessageOrigin], None],
    qos: QoSProfile,
    events: SubscriptionEventCallbacks | None = None,
) -> None:
    """Subscribe to a topic with a callback that also gets the origin of each message.

    A callback for the message's information gets message and information as two arguments from the
    executors of rclpy 7.1, but from EventsExecutor as one, a tuple. rclpy takes one that can be
    called with either for a callback that gets the message alone.
    """

    def receive(*taken: Any) -> None:
        message, info = taken[0] if len(taken) == 1 else taken
        number = info.get("publication_sequence_number")
        callback(message, MessageOrigin(info["source_timestamp"], number))

    subscription = node.create_subscription(kind, topic, receive, qos, event_callbacks=events)
    subscription._callback_type = Subscription.CallbackType.WithMessageInfo


def subscribe_with_source_time(
    node: Node, kind: type, topic: str, callback: Callable[[Any, int], None], qos: QoSProfile
) -> None:
    """Subscribe with a callback that also gets the sender's system time of a message [ns].

    Args:
        callback: Called with a message and the time at which it was sent, in nanoseconds of the
            sending host's system clock.
    """
    subscribe_with_origin(
        node, kind, topic, lambda message, origin: callback(message, origin.sent), qos
    )


def deliver(subscription: Subscription, message: Any, source_time: int) -> None:
    """Call a subscription's callback with a message, as an executor would; `source_time` in ns."""
    if subscription._callback_type is Subscription.CallbackType.MessageOnly:
        subscription.callback(message)
    else:
        subscription.callback(message, {"source_timestamp": source_time})


def log_exceptions(callback: TransitionCallback) -> TransitionCallback:
    """Log exceptions raised by a transition callback: rclpy drops them and calls `on_error`."""

    @functools.wraps(callback)
    def transition(node: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return callback(node, state)
        except Exception:
            node.get_logger().error(f"{callback.__name__} failed:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR

    return transition


#: Time after which a process is ended that does not take its node down [s].
#: Taking rclpy 7.1's EventsExecutor down while a message arrives can deadlock in the middleware,
#: with Python's interpreter lock held: no Python code runs any more, whether handler or thread.
TAKE_DOWN_TIMEOUT = 5
