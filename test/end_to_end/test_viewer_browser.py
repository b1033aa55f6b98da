"""The page in a real browser: headless Chromium drives a simulated robot."""

import math
import os
import re
import shutil
import signal
from pathlib import Path

import pytest

from omniman_ros.console.session import Session
from test import robots
from test.running import PATIENCE, Running, command, environment
from test.viewer.browser import Mouse, Robot, draw_slowly
from test.viewer.screen import first_camera

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (extra 'browser')"
)
pytest.importorskip("viser", reason="viser is not installed (extra 'viewer')")
markers = pytest.importorskip("omniman_ros.viewer.page.draggable_markers")

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium")
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium on the PATH and none named by $CHROMIUM"
)
#: Options: no network but the page's, and 3D without a graphics card.
#:
#: The plots are drawn without the emulated graphics card, which would take seconds for those of a
#: second page and hold up its mouse meanwhile.
QUIET = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-accelerated-2d-canvas",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
#: A page with few pixels in its scene, because the CPU renders them beside the robot
COARSE = "?fixedDpr=0.25"
#: The machine may stall for a moment, which must not latch a stop of the robot; and the browser
#: needs the processor, too.
SLOWLY = [
    word
    for text in (
        "frame_rate:=10.0",
        "port:=18180",
        "timeouts.wheel_states:=5.0",
        "firmware.watchdog:=0.5",
        "drive.following_time:=10.0",
        "odom_timeout:=5.0",
        "obstacles.timeout:=10.0",
        "safety.deadline:=0.05",
        "truth_rate:=10.0",
    )
    for word in ("-p", text)
]
NODES = ("simulated_drive", "platform_controller", "mpc_planner", "viewer")
ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
SIZE = {"width": 1300, "height": 780}
BODY = robots.robot("omniman").body
PLACE = 1.7, 0.5  #: Position to which the goal is dragged, ahead and beside the robot [m]
POSITION = re.compile(r"odom ([+-]\d+\.\d\d)")  #: Position x on the page
DIGIT = 0.011  #: Its resolution, with round-off [m]
HAND = 0.15  #: Accuracy of placing an object by mouse in a page with few pixels [m]
MOVED = 0.2
PRESSES = 6


@pytest.fixture(scope="module")
def domain():
    with pytest.MonkeyPatch.context() as patch:
        env = environment()
        for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
            patch.setenv(name, env[name])
        yield env


@pytest.fixture(scope="module")
def address(domain):
    """Yield the page's address of nodes that run as processes until these tests end."""
    with Running(command("up", "--arm", "none", *SLOWLY, "--only", *NODES), domain) as up:
        line = up.wait_for("the page is at ")
        yield re.search(r"http://\S+", line)[0]
        up.process.send_signal(signal.SIGINT)
        code = up.finish()
        assert code == 0, up.output


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
    """Yield a function that opens the page; script errors fail the tests."""
    errors = []

    def open_page(query=COARSE):
        opened = browser.new_page(viewport=SIZE)
        draw_slowly(opened)
        opened.set_default_timeout(1e3 * PATIENCE)
        opened.on("pageerror", lambda error: errors.append(str(error)))
        opened.goto(f"{address}/{query}")
        opened.locator("canvas").first.wait_for()
        opened.get_by_text(re.compile("simulated_drive running")).wait_for()
        return opened

    yield open_page
    assert errors == []


@pytest.fixture(scope="module")
def camera():
    return first_camera(robots.robot("omniman"))


@pytest.fixture(scope="module")
def page(open_page, robot):
    """Return a page that stays open."""
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
    """Hold a button until a condition holds; the button stays pressed.

    On a machine that stalls for seconds a page may lose its connection and return with
    new buttons: the held button is then released, and a person would press again.
    """
    for _ in range(PRESSES):
        press(page, name)
        if robot.session.wait(until, PATIENCE / PRESSES):
            return
        page.mouse.up()
    pytest.fail(f"{name} is held in vain; the page:\n{page.inner_text('body')}")


def hold_key(page, robot, key, until):
    """Hold a key until a condition holds, like `hold`."""
    for _ in range(PRESSES):
        page.keyboard.down(key)
        if robot.session.wait(until, PATIENCE / PRESSES):
            return
        page.keyboard.up(key)
    pytest.fail(f"the key {key} is held in vain; the page:\n{page.inner_text('body')}")


def drive(page, robot, name="Forward"):
    """Hold a button until the robot has moved a little."""
    start = robot.x
    hold(page, robot, name, lambda: abs(robot.x - start) > MOVED)


def is_zero(twist):
    return twist.linear.x == twist.linear.y == twist.angular.z == 0.0


def wait_for_rest(robot):
    """Wait until the robot has been at rest from now on: what was received before may be old."""
    robot.forget_rest()
    robot.wait(lambda: robot.at_rest, "the robot at rest")


def wait_until_shown(page, robot):
    """Wait until a page shows the position of the robot, to a digit that may be rounded up."""
    shown = page.get_by_text(POSITION).first

    def is_shown():
        return abs(float(POSITION.search(shown.inner_text())[1]) - robot.x) < DIGIT

    robot.wait(is_shown, "its position on the page")


def near(robot, place):
    return math.dist(robot.pose[:2], place) < HAND


def leads_to(plan, place):
    return len(plan) > 0 and math.dist(plan[-1, :2], place) < HAND


def go_until(page, robot, until, what):
    """Wait while the robot drives to its goal; on a stalling machine the planner may
    abandon the goal, and a person would send the goal again."""
    for _ in range(PRESSES):
        if robot.session.wait(until, PATIENCE / PRESSES):
            return
        if robot.planner != "driving":
            button(page, "Go").click()
    pytest.fail(f"no {what}; the page:\n{page.inner_text('body')}")


def test_held_button_drives_and_its_release_stops(page, robot):
    before = robot.x
    drive(page, robot, "Forward")
    page.mouse.up()
    robot.wait(lambda: is_zero(robot.twists[-1]), "a last twist of zero")
    wait_for_rest(robot)
    assert robot.x > before + MOVED
    assert is_zero(robot.twists[-1])
    sent = len(robot.twists)
    robot.session.spin(0.5)
    assert len(robot.twists) - sent < 5, "silence, so that others can drive"


def test_button_released_outside_its_area_counts_as_released(page, robot):
    drive(page, robot, "Back")
    page.mouse.move(600, 400)
    page.mouse.up()
    wait_for_rest(robot)


def test_second_browser_shows_the_same_and_its_loss_stops_the_robot(page, open_page, robot):
    wait_for_rest(robot)
    second = open_page()
    wait_until_shown(second, robot)
    wait_until_shown(page, robot)
    drive(second, robot, "Forward")
    second.close()
    wait_for_rest(robot)


def test_page_that_hangs_while_a_button_is_held_stops_the_robot(page, robot):
    drive(page, robot, "Back")
    # Its scripts are suspended, but its connection is alive.
    hung = page.evaluate_handle(
        "() => { setTimeout(() => { const end = Date.now() + 3000; while (Date.now() < end); }) }"
    )
    wait_for_rest(robot)
    hung.dispose()
    page.mouse.up()


def test_stop_and_reset_are_shown_and_take_effect(page, robot):
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


def test_held_key_drives_and_its_release_stops(page, robot):
    start, sent = robot.pose, len(robot.twists)
    hold_key(page, robot, "i", lambda: math.dist(robot.pose[:2], start[:2]) > MOVED)
    page.keyboard.up("i")
    robot.wait(lambda: is_zero(robot.twists[-1]), "a last twist of zero")
    wait_for_rest(robot)
    forward = [twist for twist in robot.twists[sent:] if twist.linear.x > 0.0]
    assert forward
    assert {(twist.linear.y, twist.angular.z) for twist in forward} == {(0.0, 0.0)}
    assert is_zero(robot.twists[-1])


def test_space_stops_a_robot_whose_key_is_held(page, robot):
    start = robot.pose
    hold_key(page, robot, "k", lambda: math.dist(robot.pose[:2], start[:2]) > MOVED)
    page.keyboard.press("Space")
    page.get_by_text(re.compile("platform_controller stopped: ~/stop")).wait_for()
    page.get_by_text(re.compile("simulated_drive stopped: ~/stop")).wait_for()
    wait_for_rest(robot)
    page.keyboard.up("k")
    button(page, "Reset").click()
    page.get_by_text(re.compile("platform_controller running")).wait_for()
    page.get_by_text(re.compile("driven by none")).wait_for()


def go_to_a_dragged_goal(page, robot, camera):
    """Drag the goal, have the robot drive there, and return the mouse."""
    wait_for_rest(robot)
    wait_until_shown(page, robot)
    x, y = robot.ahead(BODY.length + markers.GOAL_GAP)
    wanted = robot.ahead(*PLACE)
    mouse = Mouse(page, robot, camera)
    mouse.drag((x - 0.2, y - 0.15, 0.03), (wanted[0] - 0.2, wanted[1] - 0.15, 0.03))
    robot.wait(lambda: robot.goals, "a goal")
    robot.wait(lambda: math.dist(robot.goals[-1][:2], wanted) < HAND, "the goal where it was put")
    go_until(page, robot, lambda: leads_to(robot.plan, wanted), "plan that leads to the goal")
    go_until(page, robot, lambda: near(robot, wanted), "arrival")
    wait_for_rest(robot)
    return mouse


def test_robot_drives_to_a_dragged_goal(page, robot, camera):
    go_to_a_dragged_goal(page, robot, camera)


def test_plots_and_scene_change_while_driving(page, robot):
    """Plot and scene after driving differ from those before."""
    plot, scene = page.locator(".uplot canvas").first, page.locator("canvas[data-engine]")
    before = plot.screenshot(), scene.screenshot()
    drive(page, robot, "Forward")
    page.mouse.up()
    wait_for_rest(robot)
    assert plot.screenshot() != before[0]
    assert scene.screenshot() != before[1]
