"""Run a node as a process: its executor, signals and an orderly shutdown."""

import faulthandler
import gc
import signal
import sys
import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions

from omniman_ros.core.errors import FileError, OmnimanError
from omniman_ros.extras import Extra
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parent_process import obey_supervisor
from omniman_ros.nodes.rclpy_compat import (
    TAKE_DOWN_TIMEOUT,
    RCLError,
    UnknownROSArgsError,
    spin_for,
)
from omniman_ros.yaml_files import read_parameters

SPIN_TIME = 0.05  #: Time for which callbacks are served before the signals are looked at again [s]
#: Real time without a message on /clock after which a node that is to end does so [s]
CLOCK_TIMEOUT = 2.0
#: Time for which a node waits for its last messages to be acknowledged [s]; a reader that has died
#: never acknowledges them.
DELIVERY_TIMEOUT = 2.0
#: Time for which callbacks are served before acknowledgements are looked at again [s]
DELIVERY_SPIN_TIME = 0.005


def run(
    make: Callable[[], OmnimanNode], args: list[str] | None = None, needs: Extra | None = None
) -> int:
    """Run a node until SIGINT or SIGTERM; it comes to rest before it ends.

    rclpy's own signal handlers would shut the context down first, so that a last stop could not
    be sent. A second signal ends the node at once. Under a supervisor that the environment names,
    the node ends with it; see `nodes.parent_process`. A node that `needs` libraries which are not
    installed says so and does not start.

    Returns:
        Exit code: 0, or 1 if the node could not start or did not come to rest. Where the
        middleware does not shut down, this function does not return: after `TAKE_DOWN_TIMEOUT`
        the process is ended by SIGALRM if the node had come to rest, and with exit code 1 if it
        had not.
    """
    obey_supervisor()
    signals: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    previous = {n: signal.signal(n, on_signal) for n in (signal.SIGINT, signal.SIGTERM)}
    # Once the node is at rest, SIGALRM may end it; before that, no SIGALRM has an effect.
    previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, lambda number, frame: None)
    try:
        _require(needs)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except (OmnimanError, ParameterException, RCLError, UnknownROSArgsError) as error:
        sys.stderr.write(f"cannot start: {_unreadable_file(args) or error}\n")
        rclpy.try_shutdown()
        return 1
    follower = node.follow_clock()
    executor = EventsExecutor()
    executor.add_node(node)
    # What the imports and the node have made lasts as long as the process.
    gc.freeze()
    gc.enable()
    exit_code = 1
    try:
        while not signals:
            spin_for(executor, SPIN_TIME)
        node.begin_shutdown(signal.Signals(signals[0]).name)
        deadline = node.now() + node.stop_timeout
        while not node.finished and node.now() < deadline and len(signals) < 2:
            if follower is not None and follower.silence > CLOCK_TIMEOUT:
                break  # who published /clock has ended: simulated time stands
            spin_for(executor, SPIN_TIME)
        if follower is not None:
            follower.leave()
            _deliver(executor, [follower.publisher])
        _deliver(executor, node.final_publishers)
        exit_code = 0 if node.finished else 1
    finally:
        if exit_code == 0:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(TAKE_DOWN_TIMEOUT)
        else:
            faulthandler.dump_traceback_later(TAKE_DOWN_TIMEOUT, exit=True)
        executor.remove_node(node)
        node.destroy_node()
        rclpy.try_shutdown()
        del executor, node
        gc.unfreeze()
        gc.collect()
        signal.alarm(0)
        faulthandler.cancel_dump_traceback_later()
        for number, handler in previous.items():
            signal.signal(number, handler)
    return exit_code


def _require(needs: Extra | None) -> None:
    if needs is not None and not needs.is_available:
        raise OmnimanError(needs.hint)


def _unreadable_file(args: list[str] | None) -> FileError | None:
    """Return what is wrong with a parameter file on a command line: rcl does not say it."""
    for option, file in pairwise(sys.argv if args is None else args):
        try:
            if option == "--params-file":
                read_parameters(Path(file))
        except FileError as error:
            return error
    return None


def _deliver(executor: Executor, publishers: Iterable[Publisher]) -> None:
    """Let lost messages be sent again: an unacknowledged message dies with its publisher.

    A reader learns of a message that it has lost from the next one: the node goes on to publish.
    """
    deadline = time.monotonic() + DELIVERY_TIMEOUT
    for publisher in publishers:
        while not publisher.wait_for_all_acked(Duration()) and time.monotonic() < deadline:
            spin_for(executor, DELIVERY_SPIN_TIME)
