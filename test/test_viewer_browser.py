"""The page in a real browser: headless Chromium drives a simulated robot.

A screenshot is left in results/viewer.png.
"""

import math
import os
import re
import shutil
import signal
from pathlib import Path

import pytest
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from omniman_ros.cli.session import Session

from .cli.support import PATIENCE, Running, command, environment

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (extra 'browser')"
)
pytest.importorskip("viser", reason="viser is not installed (extra 'viewer')")

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium on the PATH and none named by $CHROMIUM"
)
QUIET = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
"""No network but the page's, and 3D without a graphics card."""
COARSE = "?fixedDpr=0.25"
"""A page whose scene has few pixels: they are computed here, next to the robot."""
SLOWLY = [
    word
    for text in (
        "frame_rate:=10.0", "port:=18180", "timeouts.wheel_states:=5.0", "firmware.watchdog:=0.5",
        "drive.following_time:=10.0",
    )
    for word in ("-p", text)
]  # fmt: skip
"""The machine may stand still for a moment, which must not stop the robot for good."""
RESULTS = Path(__file__).resolve().parents[1] / "results"
MOVED = 0.2
PRESSES = 6


class Robot:
    """The robot's topics, spun while something is waited for."""

    def __init__(self, session):
        self.session = session
        self.odom = None
        self.twists = []
        session.node.create_subscription(Odometry, "odom", self._on_odom, 1)
        session.node.create_subscription(Twist, "cmd_vel", self.twists.append, 10)

    def _on_odom(self, message):
        self.odom = message

    @property
    def x(self):
        return self.odom.pose.pose.position.x

    @property
    def speed(self):
        twist = self.odom.twist.twist
        return math.hypot(twist.linear.x, twist.linear.y) + abs(twist.angular.z)

    def wait(self, condition, what, timeout=PATIENCE):
        assert self.session.wait(condition, timeout), f"waited {timeout} s for {what}"


@pytest.fixture(scope="module")
def domain():
    with pytest.MonkeyPatch.context() as patch:
        env = environment()
        for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
            patch.setenv(name, env[name])
        yield env


@pytest.fixture(scope="module")
def address(domain):
    """Where the page is, of nodes that run as processes until the end of these tests."""
    with Running(command("up", "--arm", "none", *SLOWLY), domain) as up:
        line = up.wait_for("the page is at ")
        yield re.search(r"http://\S+", line)[0]
        up.process.send_signal(signal.SIGINT)
        code = up.finish()
        print(up.output)
        assert code == 0


@pytest.fixture(scope="module")
def robot(domain, address):
    with Session("probe") as session:
        made = Robot(session)
        made.wait(lambda: made.odom is not None, "odometry")
        yield made


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=[*QUIET], timeout=1e3 * PATIENCE
        )
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def open_page(browser, address):
    """Opens the page; errors in its scripts fail the tests."""
    errors = []

    def open_page(query=COARSE):
        opened = browser.new_page(viewport={"width": 1300, "height": 780})
        opened.set_default_timeout(1e3 * PATIENCE)
        opened.on("pageerror", lambda error: errors.append(str(error)))
        opened.goto(f"{address}/{query}")
        opened.locator("canvas").first.wait_for()
        opened.get_by_text(re.compile("simulated_drive running")).wait_for()
        return opened

    yield open_page
    assert errors == []


@pytest.fixture(scope="module")
def page(open_page, robot):
    """One page that stays open."""
    RESULTS.mkdir(exist_ok=True)
    return open_page()


def button(page, name):
    return page.get_by_role("button", name=name, exact=True)


def press(page, name):
    """Press a button and keep it pressed."""
    box = button(page, name).bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()


def hold(page, robot, name, until):
    """Hold a button until something is so; it stays pressed.

    On a machine that stands still for seconds a page may lose its connection and come back with
    new buttons: what was held is then released, and a person would press again.
    """
    for _ in range(PRESSES):
        press(page, name)
        if robot.session.wait(until, PATIENCE / PRESSES):
            return
        page.mouse.up()
    pytest.fail(f"{name} is held in vain; the page:\n{page.inner_text('body')}")


def drive(page, robot, name="Forward"):
    """Hold a button until the robot has moved a little."""
    start = robot.x
    hold(page, robot, name, lambda: abs(robot.x - start) > MOVED)


def wait_for_rest(robot):
    robot.wait(lambda: robot.speed < 0.005, "the robot at rest")


def test_a_held_button_drives_and_its_release_stops(page, robot):
    before = robot.x
    drive(page, robot, "Forward")
    page.mouse.up()
    wait_for_rest(robot)
    assert robot.x > before + MOVED
    assert [robot.twists[-1].linear.x, robot.twists[-1].angular.z] == [0.0, 0.0]
    sent = len(robot.twists)
    robot.session.spin(0.5)
    assert len(robot.twists) - sent < 5, "silence, so that others can drive"


def test_a_button_that_is_released_elsewhere_is_released(page, robot):
    drive(page, robot, "Back")
    page.mouse.move(600, 400)
    page.mouse.up()
    wait_for_rest(robot)


def test_a_second_browser_sees_the_same_and_when_it_is_lost_the_robot_stops(
    page, open_page, robot
):
    wait_for_rest(robot)
    second = open_page()
    where = re.compile(re.escape(f"odom {robot.x:+.2f}"))
    second.get_by_text(where).wait_for()
    page.get_by_text(where).wait_for()
    drive(second, robot, "Forward")
    second.close()
    wait_for_rest(robot)


def test_a_page_that_hangs_while_a_button_is_held_stops_the_robot(page, robot):
    drive(page, robot, "Back")
    # Its scripts stand still, its connection does not.
    hung = page.evaluate_handle(
        "() => { setTimeout(() => { const end = Date.now() + 3000; while (Date.now() < end); }) }"
    )
    wait_for_rest(robot)
    hung.dispose()
    page.mouse.up()


def test_stop_and_reset_are_seen_and_obeyed(page, robot):
    button(page, "Stop").click()
    page.get_by_text(re.compile("platform_controller stopped: ~/stop")).wait_for()
    page.get_by_text(re.compile("simulated_drive stopped: ~/stop")).wait_for()
    page.get_by_text(re.compile("driven by stop")).wait_for()
    start = robot.x
    hold(page, robot, "Forward", lambda: robot.twists[-1].linear.x > 0.0)
    robot.session.spin(0.5)
    page.mouse.up()
    assert abs(robot.x - start) < 0.005
    button(page, "Reset").click()
    page.get_by_text(re.compile("platform_controller running")).wait_for()
    page.get_by_text(re.compile("driven by none")).wait_for()
    drive(page, robot, "Forward")
    page.mouse.up()
    wait_for_rest(robot)


def test_the_plots_and_the_scene_move(page, open_page, robot):
    """What is drawn after driving differs from what was drawn before, in plot and scene."""
    plot, scene = page.locator(".uplot canvas").first, page.locator("canvas[data-engine]")
    before = plot.screenshot(), scene.screenshot()
    drive(page, robot, "Forward")
    page.mouse.up()
    wait_for_rest(robot)
    assert plot.screenshot() != before[0]
    assert scene.screenshot() != before[1]
    fine = open_page("")
    fine.screenshot(path=RESULTS / "viewer.png")
    fine.close()
