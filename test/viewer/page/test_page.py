"""Tests of the page on a real server, without a browser."""

import asyncio
import queue
import shutil
import socket
import ssl
import subprocess
from urllib.error import HTTPError
from urllib.request import urlopen

import msgspec
import numpy as np
import pytest
import viser
from websockets.asyncio.client import connect as open_connection
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from omniman_ros.core.errors import ParameterError
from omniman_ros.viewer.events import ButtonPressed
from omniman_ros.viewer.page.page import Page, free_port
from omniman_ros.viewer.page_access import PageAccess
from omniman_ros.viewer.view_state import ViewState
from test import robots

HOST = "127.0.0.1"


@pytest.fixture
def make_page():
    """Return a factory of pages, each on its own port, and close them after the test."""
    made = []

    def make(name="omniman", port=None, post=print, **options):
        robot = robots.robot(name)
        access = PageAccess(**{"host": HOST, "port": port or free_port(HOST, 18080), **options})
        page = Page(
            robot,
            None,
            robot.wheel_count - 3,
            (1.0, 2.0),
            access,
            post,
        )
        made.append(page)
        return page

    yield make
    for page in made:
        page.close()


def request_upgrade(page, **headers):
    with connect(
        page.address.replace("http", "ws"),
        subprotocols=[f"viser-v{viser.__version__}"],
        additional_headers=headers,
    ) as client:
        return client.recv(timeout=10)


def test_a_browser_on_this_machine_receives_the_page(make_page):
    page = make_page()
    assert request_upgrade(page)
    assert request_upgrade(page, Origin=page.address)


@pytest.mark.parametrize("origin", ["http://evil.org", "null", "http://127.0.0.1:1"])
def test_a_page_from_elsewhere_cannot_connect(make_page, origin):
    page = make_page()
    with pytest.raises(InvalidStatus) as refused:
        request_upgrade(page, Origin=origin)
    assert refused.value.response.status_code == 403
    assert b"must not control" in refused.value.response.body


def test_without_its_token_nothing_of_the_page_is_served(make_page):
    page = make_page(host="0.0.0.0")
    assert "token" not in page.address
    for wrong in ("", "?token=", "?token=wrong", f"?token={page.link[-5:]}"):
        with pytest.raises(HTTPError) as refused:
            urlopen(f"{page.address}/{wrong}")
        assert refused.value.code == 403 and b"token" in refused.value.read()
    with pytest.raises(InvalidStatus) as refused:
        request_upgrade(page)
    assert refused.value.response.status_code == 403


def test_who_shows_the_token_gets_a_cookie_that_opens_the_page(make_page):
    page = make_page(host="0.0.0.0")
    with urlopen(page.link) as answer:
        assert answer.status == 200
        cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert request_upgrade(page, Cookie=cookie.partition(";")[0])
    with pytest.raises(InvalidStatus):
        request_upgrade(page, Cookie=cookie.partition(";")[0][:-1])


def test_each_page_has_a_token_of_its_own(make_page):
    first, second = make_page(host="0.0.0.0"), make_page(host="0.0.0.0")
    assert first.link.partition("=")[2] != second.link.partition("=")[2]
    assert make_page(token="chosen-token").link.endswith("/?token=chosen-token")
    assert "token" not in make_page().link


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """Return files with a certificate for this machine and its key."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl makes the certificate")
    folder = tmp_path_factory.mktemp("tls")
    files = folder / "certificate.pem", folder / "key.pem"
    name = ("-subj", "/CN=localhost", "-addext", f"subjectAltName=IP:{HOST}")
    made = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    output = ("-out", str(files[0]), "-keyout", str(files[1]))
    subprocess.run(
        (openssl, "req", "-x509", *made, *name, *output), check=True, capture_output=True
    )
    return tuple(map(str, files))


def test_with_a_certificate_the_page_is_encrypted(make_page, certificate):
    page = make_page(token="chosen-token", tls_certificate=certificate[0], tls_key=certificate[1])
    trusted = ssl.create_default_context(cafile=certificate[0])
    assert page.link.startswith("https://")
    with urlopen(page.link, context=trusted) as answer:
        cookie = answer.headers["Set-Cookie"]
    assert "Secure" in cookie
    address = page.address.replace("http", "ws")
    assert asyncio.run(first_message(address, trusted, cookie.partition(";")[0]))
    with pytest.raises(OSError):
        urlopen(page.address.replace("https", "http"), timeout=5)


async def first_message(address, tls, cookie):
    """Return the first message of an encrypted page.

    One thread does it all: the client of `websockets.sync` reads and writes in two, which the ssl
    of Python 3.11 does not stand (2 of 100 connections hung).
    """
    async with open_connection(
        address,
        ssl=tls,
        subprotocols=[f"viser-v{viser.__version__}"],
        additional_headers={"Cookie": cookie},
    ) as client:
        return await asyncio.wait_for(client.recv(), 10)


def test_a_certificate_that_cannot_be_used_is_refused(make_page, certificate, tmp_path):
    for files in ((certificate[1], certificate[0]), (str(tmp_path / "none"), certificate[1])):
        with pytest.raises(ParameterError, match=r"tls_certificate.*cannot be used"):
            make_page(tls_certificate=files[0], tls_key=files[1])


def test_the_page_is_served_to_this_machine_alone(make_page):
    """On Linux all of 127.0.0.0/8 is this machine, but the page is bound to one address only."""
    port = int(make_page().address.rpartition(":")[2])
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) == 0
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.2", port)) != 0


def test_the_next_port_is_used_if_the_first_is_taken(make_page):
    first, second = make_page(port=18080), make_page(port=18080)
    ports = [int(page.address.rpartition(":")[2]) for page in (first, second)]
    assert 18080 <= ports[0] < ports[1]


def test_a_host_of_another_machine_is_refused():
    with pytest.raises(ParameterError, match=r"host.*203\.0\.113\.1"):
        free_port("203.0.113.1", 8080)
    with pytest.raises(ParameterError, match=r"host.*no such name"):
        free_port("no such name", 8080)


def test_an_exhausted_range_of_ports_is_an_error(monkeypatch):
    monkeypatch.setattr("omniman_ros.viewer.page.page.MAX_PORTS", 1)
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        with pytest.raises(ParameterError, match=r"port.*in use"):
            free_port(HOST, taken.getsockname()[1])


@pytest.mark.parametrize("name", robots.ALL)
def test_every_robot_is_drawn(make_page, name):
    page = make_page(name)
    n = robots.robot(name).wheel_count
    state = ViewState(n, n - 3)
    page.draw(state, 9.0)
    state.update_odom((1.0, 2.0, 0.5), 10.0)
    state.update_truth((1.1, 2.0, 0.5), 10.0)
    state.update_wheels(np.full(n, 0.3), np.ones(n), 10.0)
    state.path.set(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]))
    for i in range(12):
        state.sample(10.0 + 0.05 * i)
        page.draw(state, 10.0 + 0.05 * i)
    api = page._server.scene
    assert api.get_handle_by_name("/world/robot").position.tolist() == [1.0, 2.0, 0.0]
    assert api.get_handle_by_name("/world/robot").visible
    path = api.get_handle_by_name("/world/path")
    assert len(path.points) == 2 and path.visible
    assert not api.get_handle_by_name("/world/reference").visible
    state.path.set(np.zeros((0, 2)))
    for _ in range(5):
        page.draw(state, 11.0)
    assert not path.visible
    turned = api.get_handle_by_name("/world/robot/wheels_0/rollers").batched_wxyzs
    assert np.allclose(np.abs(turned[:, 0]), abs(np.cos(0.15) * np.cos(heading(name) / 2)))
    assert not page.watched


def heading(name):
    """Return the heading of the wheels of the first shape."""
    wheels = robots.robot(name).wheels
    kinds = list(zip(wheels.radius, wheels.roller_angle, strict=True))
    return np.array([h for h, kind in zip(wheels.heading, kinds, strict=True) if kind == kinds[0]])


@pytest.mark.parametrize(
    ("sent", "used"), [(0.4, 0.4), (9.0, 1.0), (-1.0, 0.0), (float("nan"), 0.0)]
)
def test_a_slider_cannot_exceed_the_limit(make_page, sent, used):
    page = make_page()
    page._controls._linear._impl.value = sent  # as a page sends it
    assert page.speeds[0] == used
    assert 0.0 < page.speeds[1] <= 2.0


def test_a_browser_cannot_request_a_public_url(make_page, monkeypatch):
    tunnels = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *given: tunnels.append(given))
    assert make_page()._server.request_share_url() is None
    assert tunnels == []


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 1.0, 1.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 100.0,
    "image_height": 100,
    "image_width": 100,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}  #: First message of a browser; viser ignores all others before it


def send_as_browser(page, *messages):
    """Send messages from a separate browser; bytes and text are sent unchanged."""
    with connect(
        page.address.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"]
    ) as client:
        client.recv(timeout=10)
        for message in (CAMERA, *messages):
            raw = isinstance(message, bytes | str)
            client.send(message if raw else msgspec.msgpack.encode(message))


def update(handle, **updates):
    return {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": updates}


def test_malformed_messages_of_a_browser_do_not_affect_the_others(make_page):
    posted = queue.SimpleQueue()
    page = make_page(post=posted.put)
    slider = page._controls._linear
    handles = page._server.gui._gui_input_handle_from_uuid.values()
    (stop,) = [handle for handle in handles if handle.label == "Stop"]
    for garbage in (
        b"\x00garbage",
        "text",
        ["no", "message"],
        {"type": "NoSuchMessage"},
        update(slider, value="fast"),
        update(slider, value=None),
        update(slider, nothing=1.0),
        {"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 1.0}},
    ):
        send_as_browser(page, garbage)
    send_as_browser(page, update(slider, value=float("nan")), update(stop, value=True))
    received = [posted.get(timeout=10)]
    while received[-1] != ButtonPressed("stop"):
        received.append(posted.get(timeout=10))
    assert np.isnan(slider.value), "it has arrived"
    assert page.speeds[0] == 0.0
    page.draw(ViewState(4, 1), 1.0)


def test_a_browser_cannot_disable_stop_for_the_others(make_page):
    posted = queue.SimpleQueue()
    page = make_page(post=posted.put)
    handles = page._server.gui._gui_input_handle_from_uuid.values()
    (stop,) = [handle for handle in handles if handle.label == "Stop"]
    for taken in ({"removed": True}, {"update_cb": []}, {"value": True, "disabled": True}):
        send_as_browser(page, update(stop, **taken))
    send_as_browser(page, update(stop, value=True))
    received = [posted.get(timeout=10)]
    while received[-1] != ButtonPressed("stop"):
        received.append(posted.get(timeout=10))
    assert not stop._impl.removed and not stop.disabled
