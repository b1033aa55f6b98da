"""Nodes and a probe in one private context, spun by the test on simulated time.

One period at a time: every node's clock is set, then callbacks are served until none is ready.
Nothing sleeps but the wait for matched endpoints, which has a time-out of its own.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time

T = TypeVar("T")

PERIOD = 0.005
START = 1000.0
MATCH_TIMEOUT = 20.0

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
DOMAINS = range(40, 100)[WORKER::WORKERS]
"""Of tests in this process (0 to 101 are safe on every system)."""

_next = itertools.count(os.getpid() * 7)


def free_domain() -> int:
    """A ROS_DOMAIN_ID of the test's own."""
    return DOMAINS[next(_next) % len(DOMAINS)]


class World:
    """A private context with nodes under test and a probe.

    Args:
        makers: Called with the options a node takes (context, parameter overrides).
        parameters: ROS parameters given to every node under test.
    """

    def __init__(
        self, *makers: Callable[..., Any], parameters: dict[str, Any] | None = None
    ) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.context.init(domain_id=free_domain())
        self.executor = SingleThreadedExecutor(context=self.context)
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

    # ---- time ---------------------------------------------------------------------------------

    def _set_time(self, node: Node) -> None:
        node.get_clock().set_ros_time_override(Time(nanoseconds=round(self.time * 1e9)))

    def serve(self) -> None:
        """Serve callbacks until none is ready."""
        while True:
            try:
                task, _, _ = self.executor.wait_for_ready_callbacks(timeout_sec=0)
            except TimeoutException:
                return
            task()
            if task.exception() is not None:
                raise task.exception()

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass, one period at a time; `each` and the hooks are called once a period."""
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
        """Let time pass until the condition holds; returns how long it took [s]."""
        begin = self.time
        while not condition():
            assert self.time - begin < seconds, f"waited {seconds} s for: {what}"
            self.run(PERIOD)
        return self.time - begin

    def stamp(self, ahead: float = 0.0) -> Any:
        """A stamp of now, or of some time ahead [s]."""
        return Time(nanoseconds=round((self.time + ahead) * 1e9)).to_msg()

    # ---- topics and services ------------------------------------------------------------------

    def listen(self, kind: type[T], topic: str, qos: QoSProfile | int = 100) -> list[T]:
        """Collect what is published on a topic; matched when this returns."""
        received: list[T] = []
        self.received[topic] = received
        matched: list[object] = []
        events = SubscriptionEventCallbacks(matched=matched.append, use_default_callbacks=False)
        self.probe.create_subscription(kind, topic, received.append, qos, event_callbacks=events)
        self._await(lambda: bool(matched), f"a publisher of {topic}")
        if isinstance(qos, QoSProfile) and qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            self._await(lambda: bool(received), f"the latched message of {topic}")
        return received

    def publisher(self, kind: type[T], topic: str, qos: QoSProfile | int = 10) -> Any:
        """A publisher of the probe's, matched with a subscription."""
        publisher = self.probe.create_publisher(kind, topic, qos)
        self._await(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
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
        """Wait for the middleware itself (discovery, services), in real time."""
        deadline = time.monotonic() + MATCH_TIMEOUT
        while not condition():
            assert time.monotonic() < deadline, f"waited {MATCH_TIMEOUT} s for {what}"
            self.executor.spin_once(timeout_sec=0.01)


def last(messages: Iterable[T]) -> T:
    """The last message of a list that must not be empty."""
    *_, final = messages
    return final
