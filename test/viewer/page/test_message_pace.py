import asyncio
from functools import partial

import pytest
import websockets.asyncio.server
from websockets.asyncio.client import connect

from omniman_ros.viewer.page.message_pace import BURST, RATE, MessagePace
from omniman_ros.viewer.page.request_guard import RequestGuard
from omniman_ros.viewer.page.viser_compat import guarded_server

FLOOD = 10 * BURST  #: Messages that a page sends at once; at the permitted rate they take 9 s
PRESSES = BURST // 2  #: Messages of another page, each of which is answered before the next


def test_a_page_that_is_used_never_waits():
    pace = MessagePace()
    assert not any(pace.delay(0.0) for _ in range(BURST))
    pace = MessagePace()
    assert not any(pace.delay(k / 60.0) for k in range(1000))


def test_a_flood_is_read_at_the_permitted_rate():
    pace, now = MessagePace(), 5.0
    for _ in range(FLOOD):
        now += pace.delay(now)
    assert now - 5.0 == pytest.approx((FLOOD - BURST) / RATE)


def test_after_a_rest_there_is_room_for_another_burst_but_not_for_two():
    pace = MessagePace()
    for _ in range(BURST):
        pace.delay(0.0)
    assert pace.delay(0.0) > 0.0
    assert not any(pace.delay(100.0) for _ in range(BURST))
    assert pace.delay(100.0) > 0.0


@pytest.mark.processes
def test_a_flood_of_one_page_leaves_the_server_to_another():
    """All that another page sends is answered while most of the flood waits."""
    read, ended = {"flood": 0, "press": 0}, []

    async def handle(connection):
        while not ended:
            kind = await connection.recv()
            read[kind] += 1
            if kind == "press":
                await connection.send("done")

    async def run():
        with guarded_server(RequestGuard("127.0.0.1", 0)):
            serving = websockets.asyncio.server.serve(
                handle, "127.0.0.1", 0, process_request=lambda *_: None, close_timeout=0.1
            )
        async with serving as server:
            port = server.sockets[0].getsockname()[1]
            address = f"ws://127.0.0.1:{port}"
            link = partial(connect, address, close_timeout=0.1)
            async with link() as one, link() as other:

                async def flood():
                    for _ in range(FLOOD):
                        await one.send("flood")

                flooding = asyncio.create_task(flood())
                while read["flood"] < BURST:
                    await asyncio.sleep(0.0)
                for _ in range(PRESSES):
                    await other.send("press")
                    await other.recv()
                flooding.cancel()
                ended.append(True)  # else the flood is read before the connection closes
                return read["flood"]

    meanwhile = asyncio.run(asyncio.wait_for(run(), 60.0))
    assert read["press"] == PRESSES
    assert BURST <= meanwhile < FLOOD // 2
