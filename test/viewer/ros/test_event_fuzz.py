"""Random events of a page, of all kinds and with any numbers, on the viewer's node."""

import contextlib
import dataclasses
import math
import random
import typing
from enum import Enum
from types import UnionType

import pytest
from rclpy.publisher import Publisher

from omniman_ros.core.errors import InputError
from omniman_ros.viewer.events import ButtonPressed, CaseSelected, Event, ParameterChanged
from test.fuzz import examples
from test.nodes.random_messages import FLOATS
from test.nodes.test_fuzz import numbers
from test.viewer.ros.fake_page import view

COUNT = examples(1000)  #: Number of events
BETWEEN_TICKS = 25  #: Number of events that are posted between two periods of the node
WORDS = {
    ButtonPressed: (
        "pause",
        "resume",
        "cancel",
        "go",
        "restart",
        "add",
        "clear",
        "reset",
        "x",
        "tool_place",
        "tool_add",
        "tool_send",
        "tool_remove",
    ),
    CaseSelected: ("I", "II", "III", "", "IV"),
    ParameterChanged: ("weights.energy", "weights.position", "safety.clearance", "no.such", ""),
}  #: Texts of some kinds of events, known and unknown ones
COMMANDS = (
    "cmd_vel",
    "goal_pose",
    "goal_state",
    "goal_trajectory",
    "initialpose",
    "obstacles",
    "tool_path",
)  #: Topics that move something, or that others move by
MOTIONS = ("forward", "back", "left", "right", "turn_left", "turn_right", "up", "")


class RandomEvents:
    """Makes events of all kinds by a seed."""

    def __init__(self, seed):
        self._draw = random.Random(seed)
        self._kinds = typing.get_args(Event)

    def make(self):
        while True:
            kind = self._draw.choice(self._kinds)
            with contextlib.suppress(InputError):  # a path of which there is none
                return self._instance(kind, WORDS.get(kind, MOTIONS))

    def _instance(self, kind, words):
        hints = typing.get_type_hints(kind)
        fields = [each.name for each in dataclasses.fields(kind) if each.init]
        return kind(**{name: self._value(hints[name], words) for name in fields})

    def _value(self, hint, words):
        draw, origin, items = self._draw, typing.get_origin(hint), typing.get_args(hint)
        if origin in (UnionType, typing.Union):
            return self._value(draw.choice(items), words)
        if origin is tuple:
            chosen = items[:1] * draw.randrange(5) if Ellipsis in items else items
            return tuple(self._value(item, words) for item in chosen)
        if isinstance(hint, type) and issubclass(hint, Enum):
            return draw.choice(list(hint))
        if dataclasses.is_dataclass(hint):
            return self._instance(hint, words)
        number = draw.choice(FLOATS) if draw.random() < 0.3 else draw.uniform(-3.0, 3.0)
        whole = draw.choice((0, 1, 2, 3, -1, 10**9))
        plain = {bool: whole > 1, int: whole, float: number, str: draw.choice(words)}
        return plain.get(hint)


def test_no_event_ends_the_node_or_makes_it_publish_what_is_not_finite(monkeypatch):
    sent, events = [], RandomEvents(11)
    publish = Publisher.publish

    def record(self, message):
        if self.topic_name.lstrip("/") in COMMANDS:
            sent.append((self.topic_name, message))
        publish(self, message)

    monkeypatch.setattr(Publisher, "publish", record)
    topics = set()
    with view() as world:
        (node,) = world.nodes
        world.run(0.1)
        for k in range(COUNT):
            node.page.post(events.make())
            if k % BETWEEN_TICKS == 0:
                world.run(0.05)
                assert all(math.isfinite(n) for _, message in sent for n in numbers(message))
                topics |= {topic for topic, _ in sent}
                sent.clear()
        world.run(0.5)
        assert node.page.frames[-1] == pytest.approx(world.time, abs=0.2), "it still draws"
    assert len(topics) > 2, "events have an effect"
