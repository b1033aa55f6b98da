"""Nodes and a probe in one private context, spun by the test on simulated time.

The test advances one period at a time: it sets every node's clock and serves what is ready. Only
the wait for matched endpoints sleeps; it has its own timeout.
"""

import fcntl
import itertools
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import EventHandler, SubscriptionEventCallbacks
from rclpy.executors import InvalidHandle, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.time import Time
from rclpy.timer import Timer

from omniman_ros.processes.ros_domain import is_free

T = TypeVar("T")

PERIOD = 0.005
START = 1000.0
MATCH_TIMEOUT = 20.0

DOMAINS = range(40, 102)  #: ROS domains of the tests; up to 101, they are safe on every system
KEPT_DOMAINS = 8  #: Number of domains that a process takes in turn

_locks: dict[int, int] = {}  # file descriptors by domain, until the process ends
_turns = itertools.count()


def free_domain() -> int:
    """Return a ROS_DOMAIN_ID that no test of another process uses.

    Processes that ran on a domain at the same time, of two runs even, would hear each other.
    """
    folder = Path(tempfile.gettempdir(), f"omniman_ros_test_domains_{os.getuid()}")
    folder.mkdir(exist_ok=True)
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        if len(_locks) == KEPT_DOMAINS:
            break
        lock = os.open(folder / str(domain), os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        if is_free(domain):
            _locks[domain] = lock
    assert _locks, "all ROS domains of the tests are in use"
    return list(_locks)[next(_turns) % len(_locks)]


class SteppedExecutor(SingleThreadedExecutor):
    """Serves what is ready.

    rclpy makes a wait set of all entities for each pass, which took most of the time of a test of
    thousands of passes. Timers and subscriptions are therefore asked directly, in the same order
    (rclpy 7.1, `_wait_for_ready_callbacks` and the `_take` methods of its executors), once each.
    Where a node has other kinds of entities, rclpy serves all of them; services are asked only for
    clients of other processes, or where a node has a client.

    Attributes:
        has_clients_elsewhere: Whether other processes call the nodes' services.
    """

    is_serving_by_rclpy = False
    has_clients_elsewhere = False

    def can_execute(self, entity: Any) -> bool:
        # Every endpoint has several events (mismatched QoS, matched, ...), which nobody waits for.
        if self.is_serving_by_rclpy and isinstance(entity, EventHandler):
            return False
        return bool(super().can_execute(entity))

    def serve(self) -> None:
        """Serve once what is ready."""
        nodes = self.get_nodes()
        is_busy = not all(task.done() for task, _, _ in self._tasks)
        if is_busy or any(map(_has_other_entities, nodes)):
            self._serve_by_rclpy()
            return
        callbacks = [callback for node in nodes for callback in _ready_callbacks(node)]
        has_clients = any(True for node in nodes for _ in node.clients)
        callbacks += [answer for node in nodes for answer in _responses(node)]
        if self.has_clients_elsewhere or has_clients:
            callbacks += [answer for node in nodes for answer in _requests(node)]
        for callback in callbacks:
            with suppress(InvalidHandle):  # another callback has destroyed the entity
                callback()

    def _serve_by_rclpy(self) -> None:
        self.is_serving_by_rclpy = True
        try:
            while True:
                task, _, _ = self.wait_for_ready_callbacks(timeout_sec=0)
                task()
                if task.exception() is not None:
                    raise task.exception()
        except TimeoutException:
            return
        finally:
            self.is_serving_by_rclpy = False


def _do_match(publisher: Publisher, subscription: Subscription) -> bool:
    """Return whether two endpoints find each other, by topic, type and quality of service."""
    return bool(
        subscription.topic_name == publisher.topic_name
        and subscription.msg_type is publisher.msg_type
        and qos_check_compatible(publisher.qos_profile, subscription.qos_profile)[0]
        != QoSCompatibility.ERROR
    )


def _has_other_entities(node: Node) -> bool:
    """Return whether a node has entities besides timers, subscriptions, calls and events."""
    return any(True for _ in node.guards) or not all(
        isinstance(waitable, EventHandler) for waitable in node.waitables
    )


def _ready_callbacks(node: Node) -> Iterator[Callable[[], None]]:
    """Take what is ready in a node: its timers, and one message of each subscription."""
    for timer in node.timers:
        if timer.handle.is_timer_ready():
            yield partial(_call_timer, timer)
    for subscription in node.subscriptions:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is not None:
            yield partial(_receive, subscription, taken)


def _requests(node: Node) -> Iterator[Callable[[], None]]:
    """Take one request of each of a node's services."""
    for service in node.services:
        request, header = service.handle.service_take_request(service.srv_type.Request)
        if request is not None:
            yield partial(_answer, service, request, header)


def _responses(node: Node) -> Iterator[Callable[[], None]]:
    """Take one response of each of a node's clients."""
    for client in node.clients:
        header, response = client.handle.take_response(client.srv_type.Response)
        if header is not None:
            number = header.request_id.sequence_number
            yield partial(client.get_pending_request(number).set_result, response)


def _call_timer(timer: Timer) -> None:
    if not timer.is_canceled():  # by a callback before it
        timer.handle.call_timer()
        timer.callback()


def _receive(subscription: Subscription, taken: tuple[Any, Any]) -> None:
    _ = subscription.handle.pointer  # raises InvalidHandle if it was destroyed
    is_message_only = subscription._callback_type is Subscription.CallbackType.MessageOnly
    subscription.callback(*taken[:1] if is_message_only else taken)


def _answer(service: Service, request: Any, header: Any) -> None:
    service.send_response(service.callback(request, service.srv_type.Response()), header)


class World:
    """A private context with nodes under test and a probe.

    Args:
        makers: Called with the options a node takes (context, parameter overrides).
        parameters: ROS parameters given to every node under test.

    Attributes:
        domain: ROS domain of the context.
        nodes: The nodes under test.
        probe: The node that the test publishes and listens with.
        time: Time of all their clocks [s].
        hooks: Functions that are called once per period.
    """

    def __init__(
        self, *makers: Callable[..., Any], parameters: dict[str, Any] | None = None
    ) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.domain = free_domain()
        self.context.init(domain_id=self.domain)
        self.executor = SteppedExecutor(context=self.context)
        given = {"use_sim_time": True} | (parameters or {})
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.nodes: list[Any] = []
        self.received: dict[str, list[Any]] = {}
        self.hooks: list[Callable[[], None]] = []
        self.time = START
        self.probe = Node("probe", context=self.context, parameter_overrides=overrides[:1])
        self.executor.add_node(self.probe)
        self._set_time(self.probe)
        try:
            for make in makers:
                node = make(context=self.context, parameter_overrides=overrides)
                self.nodes.append(node)
                self.executor.add_node(node)
                self._set_time(node)
            self.match_endpoints()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Destroy the nodes and shut the context down."""
        for node in [*self.nodes, self.probe]:
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown(timeout_sec=0)
        self.context.try_shutdown()
        assert not self.context.ok()

    def match_endpoints(self, *others: Node) -> None:
        """Wait until the nodes under test, and others, have discovered each other's topics.

        The middleware repeats a latched message to a later subscription from a thread of its own,
        now and then 70 ms after the match: this waits for it, too.
        """
        nodes = [*self.nodes, *others]
        publishers = [publisher for node in nodes for publisher in node.publishers]
        subscriptions = [subscription for node in nodes for subscription in node.subscriptions]
        for subscription in subscriptions:
            writers = sum(_do_match(publisher, subscription) for publisher in publishers)
            self._await(
                lambda s=subscription, n=writers: s.get_publisher_count() >= n,
                f"the publishers of {subscription.topic_name}",
            )
        for publisher in publishers:
            readers = sum(_do_match(publisher, subscription) for subscription in subscriptions)
            self._await(
                lambda p=publisher, n=readers: p.get_subscription_count() >= n,
                f"the subscribers of {publisher.topic_name}",
            )
            if publisher.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL:
                is_delivered = publisher.wait_for_all_acked(Duration(seconds=MATCH_TIMEOUT))
                assert is_delivered, f"the latched message of {publisher.topic_name} is missing"

    # ---- time ---------------------------------------------------------------------------------

    def _set_time(self, node: Node) -> None:
        node.get_clock().set_ros_time_override(Time(nanoseconds=round(self.time * 1e9)))

    def serve(self) -> None:
        """Serve once what is ready."""
        self.executor.serve()

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Advance time period by period; `each` and the hooks are called once per period."""
        for _ in range(round(seconds / PERIOD)):
            for hook in self.hooks:
                hook()
            if each is not None:
                each()
            self.time += PERIOD
            for node in [*self.nodes, self.probe]:
                self._set_time(node)
            self.serve()

    def run_until(self, condition: Callable[[], bool], seconds: float, what: str) -> float:
        """Advance time until the condition holds; return the elapsed time [s]."""
        begin = self.time
        while not condition():
            assert self.time - begin < seconds, f"waited {seconds} s for: {what}"
            self.run(PERIOD)
        return self.time - begin

    def stamp(self, ahead: float = 0.0) -> Any:
        """Return a stamp of the current time, or `ahead` seconds later."""
        return Time(nanoseconds=round((self.time + ahead) * 1e9)).to_msg()

    # ---- topics and services ------------------------------------------------------------------

    def listen(self, kind: type[T], topic: str, qos: QoSProfile | int = 100) -> list[T]:
        """Collect the messages of a topic; the endpoints are matched on return."""
        received: list[T] = []
        self.received[topic] = received
        matched: list[object] = []
        events = SubscriptionEventCallbacks(matched=matched.append, use_default_callbacks=False)
        publishers = [publisher for node in self.nodes for publisher in node.publishers]
        counts = {publisher: publisher.get_subscription_count() for publisher in publishers}
        subscription = self.probe.create_subscription(
            kind, topic, received.append, qos, event_callbacks=events
        )
        self._await(lambda: bool(matched), f"a publisher of {topic}")
        for publisher in publishers:
            if _do_match(publisher, subscription):
                self._await(
                    lambda p=publisher, n=counts[publisher]: p.get_subscription_count() > n,
                    f"a subscriber of {topic}",
                )
        if isinstance(qos, QoSProfile) and qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            self._await(lambda: bool(received), f"the latched message of {topic}")
        return received

    def publisher(self, kind: type[T], topic: str, qos: QoSProfile | int = 10) -> Any:
        """Return a publisher of the probe that is matched with a subscription.

        Both ends must know of the other. What is published before the subscription does arrives
        only when the middleware repeats it, and holds up all that follows.
        """
        subscriptions = [
            subscription for node in self.nodes for subscription in node.subscriptions
        ]
        before = [subscription.get_publisher_count() for subscription in subscriptions]
        publisher = self.probe.create_publisher(kind, topic, qos)
        self._await(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
        for subscription, count in zip(subscriptions, before, strict=True):
            if _do_match(publisher, subscription):
                self._await(
                    lambda s=subscription, n=count: s.get_publisher_count() > n,
                    f"a publisher of {topic}",
                )
        return publisher

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """Call a service and return its response."""
        client = self.probe.create_client(kind, name)
        self._await(client.service_is_ready, f"service {name}")
        future = client.call_async(request or kind.Request())
        self._await(future.done, f"an answer of {name}")
        self.probe.destroy_client(client)
        return future.result()

    def _await(self, condition: Callable[[], bool], what: str) -> None:
        """Wait in real time for the middleware (discovery, services)."""
        deadline = time.monotonic() + MATCH_TIMEOUT
        while not condition():
            assert time.monotonic() < deadline, f"waited {MATCH_TIMEOUT} s for {what}"
            self.executor.spin_once(timeout_sec=0.01)


def last(messages: Iterable[T]) -> T:
    """Return the latest message of a list that must not be empty."""
    *_, final = messages
    return final
