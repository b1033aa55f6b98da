"""Tests of the scene in headless Chromium, without ROS: the mouse drags objects."""

import contextlib
import io
import math
import os
import shutil
import threading
import time

import numpy as np
import pytest
import viser

from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.viewer.events import (
    GoalDragged,
    ObstacleDragged,
    ObstacleSelected,
    ObstacleVelocitySet,
)
from omniman_ros.viewer.page.draggable_markers import ARROW_HEIGHT
from omniman_ros.viewer.page.page import free_port
from omniman_ros.viewer.page.scene import PageScene
from omniman_ros.viewer.placed_obstacles import PlacedObstacles
from omniman_ros.viewer.view_state import ViewState
from test import robots
from test.viewer.browser import draw_slowly
from test.viewer.screen import of_client

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (extra 'browser')"
)
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium on the PATH and none named by $CHROMIUM"
    ),
]
FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  #: Options that disable all network access except the page, and render 3D in software
HOST, PATIENCE, STEPS = "127.0.0.1", 60.0, 5
NEAR = 0.12  #: Accuracy of a drag over pixels of about a centimetre [m]


class Theatre:
    """A scene that a thread draws, which also processes the events of the browser."""

    def __init__(self):
        robot = robots.robot("omniman")
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=HOST, port=free_port(HOST, 19140), verbose=False)
        self.events, self._done = [], 0
        self.scene = PageScene(self.server, robot, None, self.events.append)
        self.state = ViewState(robot.wheel_count, 1)
        self.state.update_odom((5.0, 3.0, 0.0), 0.0)
        self.obstacles = PlacedObstacles()
        self.obstacles.pause(0.0)
        self.tip = float(self.handle("goal/knob").vertices[:, 0].mean())
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def handle(self, name):
        return self.server.scene.get_handle_by_name(f"/world/{name}")

    def _run(self):
        while not self._over.wait(0.05):
            while self._done < len(self.events):
                self._do(self.events[self._done])
                self._done += 1
            self.state.obstacles = self.obstacles.arrays(0.0)
            with self.server.atomic():
                self.scene.draw(self.state, True)

    def _do(self, event):
        if isinstance(event, GoalDragged):
            self.state.goal = event.pose
        elif isinstance(event, ObstacleDragged):
            self.obstacles.move(event.number, event.position, 0.0)
        elif isinstance(event, ObstacleVelocitySet):
            self.obstacles.set_velocity(event.number, event.velocity, 0.0)

    def close(self):
        self._over.set()
        self._thread.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


@pytest.fixture(scope="module")
def theatre():
    made = Theatre()
    yield made
    made.close()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=[*FLAGS], timeout=1e3 * PATIENCE
        )
        yield chromium
        chromium.close()


class Mouse:
    """The window of a browser and its mouse, which points at positions in `odom`."""

    def __init__(self, browser, theatre):
        self.theatre = theatre
        self.page = browser.new_page(viewport={"width": 1200, "height": 700})
        draw_slowly(self.page)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.errors = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        known = set(theatre.server.get_clients())
        self.page.goto(f"http://{HOST}:{theatre.server.get_port()}/?fixedDpr=0.25")
        self.canvas = self.page.locator("canvas[data-engine]")
        self.canvas.wait_for()
        self.wait(lambda: set(theatre.server.get_clients()) - known, "a client")
        (number,) = set(theatre.server.get_clients()) - known
        self.client = theatre.server.get_clients()[number]
        # The object drawn last can be grabbed.
        self.page.wait_for_timeout(1500)

    def wait(self, condition, what):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"waited {PATIENCE} s for {what}"
            self.page.wait_for_timeout(50)

    def at(self, x, y, z):
        """Return the pixel of a position in `odom`; the world follows the robot."""
        odom = self.theatre.state.odom
        box = self.canvas.bounding_box()
        point = x - odom[0], y - odom[1], z
        u, v = of_client(self.client.camera, point, box["width"], box["height"])
        return box["x"] + u, box["y"] + v

    def grab(self, place, to):
        """Press at a position and drag to another; return the number of earlier events."""
        before, start, end = len(self.theatre.events), self.at(*place), self.at(*to)
        self.page.mouse.move(*start)
        self.page.wait_for_timeout(100)
        self.page.mouse.down()
        for step in range(1, STEPS + 1):
            way = step / STEPS
            self.page.mouse.move(*(a + way * (b - a) for a, b in zip(start, end, strict=True)))
            self.page.wait_for_timeout(60)
        return before

    def drag(self, place, to):
        """Drag from a position to another, release, and return the events posted."""
        before, events = self.grab(place, to), self.theatre.events
        self.page.mouse.up()
        self.wait(
            lambda: any(getattr(event, "done", True) for event in events[before:]), "the drag"
        )
        self.page.wait_for_timeout(300)
        return events[before:]


@pytest.fixture(scope="module")
def mouse(browser, theatre):
    made = Mouse(browser, theatre)
    yield made
    assert made.errors == []


def test_a_pending_goal_can_be_dragged_and_turned(mouse, theatre):
    x, y = theatre.handle("goal").position[:2]
    posted = mouse.drag((x - 0.2, y - 0.15, 0.03), (x + 0.8, y - 0.95, 0.03))
    assert all(isinstance(event, GoalDragged) for event in posted)
    assert [event.done for event in posted] == [False] * (len(posted) - 1) + [True]
    assert len(posted) > 2, "the goal follows the mouse"
    assert posted[-1].pose == pytest.approx((x + 1.0, y - 0.8, 0.0), abs=NEAR)
    x, y, _ = posted[-1].pose
    posted = mouse.drag((x + theatre.tip, y, 0.06), (x, y + theatre.tip, 0.06))
    assert posted[-1].pose[:2] == (x, y)
    assert posted[-1].pose[2] == pytest.approx(math.pi / 2, abs=0.1)


def test_an_obstacle_can_be_dragged_given_a_velocity_and_selected(mouse, theatre):
    """The number of instances changes between the drags."""
    theatre.obstacles.add(TwoVelocityPath((5.0, 4.4)), 0.0)
    number = theatre.obstacles.add(TwoVelocityPath((6.0, 4.2)), 0.0)
    mouse.page.wait_for_timeout(800)
    posted = mouse.drag((6.0, 4.2, 0.3), (6.4, 3.9, 0.3))
    assert posted[-1] == ObstacleDragged(number, pytest.approx((6.4, 3.9), abs=NEAR), True)
    theatre.obstacles.delete(0)
    mouse.page.wait_for_timeout(800)
    x, y = posted[-1].position
    posted = mouse.drag((x, y, ARROW_HEIGHT), (x + 0.6, y + 0.3, ARROW_HEIGHT))
    assert posted[-1] == ObstacleVelocitySet(number, pytest.approx((0.6, 0.3), abs=NEAR))
    before = len(theatre.events)
    mouse.page.mouse.click(*mouse.at(x, y, 0.3))
    mouse.wait(lambda: len(theatre.events) > before, "a click")
    assert theatre.events[before:] == [ObstacleSelected(number)]


def test_a_drag_beside_all_objects_turns_the_camera(mouse, theatre):
    before, position = len(theatre.events), np.array(mouse.client.camera.position)
    mouse.grab((4.0, 4.0, 0.0), (3.5, 4.2, 0.0))
    mouse.page.mouse.up()
    mouse.wait(
        lambda: np.linalg.norm(mouse.client.camera.position - position) > 0.05, "the camera"
    )
    assert theatre.events[before:] == []


def test_a_window_closed_during_a_drag_releases_the_object_and_sends_nothing(
    browser, mouse, theatre
):
    theatre.state.goal = (6.5, 3.0, 0.0)
    second = Mouse(browser, theatre)
    before = second.grab((6.4, 2.9, 0.03), (6.8, 2.6, 0.03))
    mouse.wait(lambda: len(theatre.events) > before, "the drag")
    number = second.client.client_id
    second.page.close()
    mouse.wait(lambda: number not in theatre.server.get_clients(), "the window's end")
    mouse.page.wait_for_timeout(300)
    assert {event.done for event in theatre.events[before:]} == {False}
    held = theatre.server.scene._active_drag_handles
    assert not held
