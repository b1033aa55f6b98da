"""Random frames of a browser on the page's real server, well-formed and damaged."""

import logging
import math
import queue
import random

import msgspec
import pytest
import viser
from viser import _messages
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from omniman_ros.viewer.events import ButtonPressed
from omniman_ros.viewer.page.message_pace import MessagePace
from omniman_ros.viewer.page.page import Page, free_port
from omniman_ros.viewer.page_access import PageAccess
from test import robots
from test.fuzz import examples
from test.nodes.random_messages import FLOATS

HOST = "127.0.0.1"
COUNT = examples(300)  #: Number of frames: each that is no message of viser costs a new connection
PATIENCE = 60.0  #: Real time for an answer of the page, whose server runs in a thread [s]
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 1.0],
    "image_height": 100,
    "image_width": 100,
    "fov": 1.0,
    "near": 0.1,
    "far": 10.0,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}  #: What a browser sends first


class RandomFrames:
    """Makes frames by a seed, for the controls of a page."""

    def __init__(self, seed, page):
        self._draw = random.Random(seed)
        self._controls = list(page._server.gui._gui_input_handle_from_uuid)
        server = page._server
        kinds = {*server._websock_server._incoming_handlers}
        self._kinds = sorted(kind.__name__ for kind in kinds)

    def make(self):
        draw = self._draw
        if draw.random() < 0.6:
            content = {"type": "GuiUpdateMessage", "uuid": draw.choice(self._controls)}
            content["updates"] = {"value": self._value(2)}
        else:
            name = draw.choice(self._kinds)
            fields = getattr(_messages, name).__dataclass_fields__
            content = {field: self._value(2) for field in fields} | {"type": name}
        frame = msgspec.msgpack.encode(content)
        chance = draw.random()
        if chance < 0.01:
            return frame[: draw.randrange(len(frame))]
        if chance < 0.02:
            place = draw.randrange(len(frame))
            return frame[:place] + bytes([draw.randrange(256)]) + frame[place + 1 :]
        return frame

    def _value(self, depth):
        draw = self._draw
        plain = (
            True,
            False,
            None,
            draw.choice(FLOATS),
            draw.uniform(-3.0, 3.0),
            draw.randrange(9),
        )
        texts = ("", "click", "pointerup", draw.choice(self._controls))
        if depth and draw.random() < 0.3:
            return [self._value(depth - 1) for _ in range(draw.randrange(4))]
        return draw.choice((*plain, *texts))


@pytest.fixture
def unlogged():
    """Drop the tracebacks of viser and websockets, one for each frame that they cannot read."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(before)


@pytest.mark.processes
def test_no_frame_of_a_browser_ends_the_page_or_makes_its_speeds_infinite(monkeypatch, unlogged):
    monkeypatch.setattr(MessagePace, "delay", lambda self, now: 0.0)
    posted = queue.SimpleQueue()
    robot = robots.robot("omniman")
    access = PageAccess(host=HOST, port=free_port(HOST, 18080))
    page = Page(robot, None, robot.wheel_count - 3, (1.0, 2.0), access, posted.put)
    try:
        frames = RandomFrames(5, page)
        sent = 0
        while sent < COUNT:
            with connected(page) as client:
                try:
                    while sent < COUNT:
                        client.send(frames.make())
                        sent += 1
                except (ConnectionClosed, WebSocketException):
                    pass
        handles = page._server.gui._gui_input_handle_from_uuid.values()
        (stop,) = [handle for handle in handles if handle.label == "Stop"]
        with connected(page) as client:
            update = {"type": "GuiUpdateMessage", "uuid": stop._impl.uuid}
            client.send(msgspec.msgpack.encode(update | {"updates": {"value": True}}))
            events = [posted.get(timeout=PATIENCE)]
            while events[-1] != ButtonPressed("stop") or not posted.empty():
                events.append(posted.get(timeout=PATIENCE))
    finally:
        page.close()
    kinds = {type(event).__name__ for event in events}
    assert len(kinds) > 2, "frames have an effect"
    assert all(math.isfinite(speed) for speed in page.speeds)


def connected(page):
    """Return a connection as a browser's, whose camera is known."""
    client = connect(
        page.address.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"]
    )
    client.recv(timeout=PATIENCE)
    client.send(msgspec.msgpack.encode(CAMERA))
    return client
