"""Workarounds for defects of rclpy, and access to parts of it without a public interface.

All of them are for rclpy 7.1, the version of ROS 2 Jazzy.
"""

import functools
import traceback
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

RCLError = rclpy_implementation.RCLError
"""Error of the middleware. rclpy 7.1 raises it, but exports it in its implementation only."""
UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError
"""Error about ROS arguments. rclpy 7.1 raises it, but exports it in its implementation only."""

TransitionCallback = Callable[[Any, LifecycleState], TransitionCallbackReturn]
"""Callback of a lifecycle node for one of its transitions, as a function of the node."""


def parameter_overrides(node: Node) -> Mapping[str, Parameter]:
    """Return the parameters given on the command line and in files, declared or not.

    rclpy 7.1 keeps them in a private attribute, and ignores undeclared ones silently.
    """
    overrides: Mapping[str, Parameter] = node._parameter_overrides
    return overrides


def make_executor(clock: Clock) -> Executor:
    """Return the leanest executor for timers of a clock.

    The timers of rclpy 7.1's EventsExecutor do not follow jumps of ROS time, so ROS time gets the
    plain executor.
    """
    if clock.clock_type is ClockType.ROS_TIME:
        return SingleThreadedExecutor()
    return EventsExecutor()


def spin_for(executor: Executor, seconds: float) -> None:
    """Serve callbacks for some seconds.

    In rclpy 7.1 EventsExecutor.spin() hangs without a timeout; a future that never completes
    gives it one.
    """
    executor.spin_until_future_complete(rclpy.Future(), timeout_sec=seconds)


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


TAKE_DOWN_TIMEOUT = 5
"""Time after which a process is ended that does not take its node down [s].

Taking rclpy 7.1's EventsExecutor down while a message arrives can deadlock in the middleware,
with Python's interpreter lock held: no Python code runs any more, whether handler or thread.
"""
