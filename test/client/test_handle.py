"""Handles of motions, without ROS and without time."""

import subprocess
import sys

import pytest

from omniman_ros.client.handle import MotionError, MotionHandle, MotionResult, Outcome
from omniman_ros.client.state import Reading, RobotError, RobotTimeoutError
from omniman_ros.core.errors import OmnimanError

NODE = "/mpc_planner"


class Link:
    """A connection whose node does in each wait what a test lets it do."""

    def __init__(self):
        self.handle, self.script, self.cancelled = MotionHandle("goal", "goal", self), [], []

    def wait(self, condition, timeout):
        while not condition():
            if not self.script:
                return False
            self.script.pop(0)()
        return True

    def request_cancel(self, handle):
        self.cancelled.append(handle)

    def tell(self, *events):
        """Let events happen, one in each wait."""
        for event, reason in events:
            self.script.append(lambda e=event, r=reason: self.handle.report(NODE, e, r))


@pytest.fixture
def link():
    return Link()


def test_a_motion_that_was_sent_has_no_outcome(link):
    handle = link.handle
    assert handle.outcome is None and handle.reason == "" and handle.feedback.state == "sent"
    assert handle.feedback.progress is None and handle.feedback.remaining is None


def test_wait_returns_when_the_robot_has_arrived(link):
    link.tell(("received", ""), ("started", ""), ("arrived", ""))
    link.handle.wait(timeout=60)
    assert link.handle.outcome is Outcome.ARRIVED


@pytest.mark.parametrize("outcome", [o for o in Outcome if o is not Outcome.ARRIVED])
def test_every_other_end_is_a_result_and_an_error_of_wait(link, outcome):
    link.tell(("received", ""), (outcome.value, "why"))
    assert link.handle.result(timeout=60) == MotionResult(outcome, "why")
    with pytest.raises(MotionError, match="why") as raised:
        link.handle.wait()
    assert (raised.value.outcome, raised.value.reason) == (outcome, "why")


def test_a_time_out_is_an_error_of_the_package_and_says_what_the_motion_does(link):
    link.tell(("waiting", "no odom yet"))
    with pytest.raises(RobotTimeoutError, match=r"within 2 s \(waiting: no odom yet\)") as raised:
        link.handle.wait(timeout=2.0)
    assert isinstance(raised.value, TimeoutError) and isinstance(raised.value, OmnimanError)
    assert link.handle.outcome is None


def test_nothing_changes_an_end(link):
    for event in ("cancelled", "arrived", "started"):
        link.handle.report(NODE, event, event)
    link.handle.lose("the node has ended")
    assert link.handle.result() == MotionResult(Outcome.CANCELLED, "cancelled")


def test_a_goal_progresses_from_its_farthest_distance_once_it_has_started(link):
    handle = link.handle
    handle.approach(0.5)
    assert handle.feedback.progress is None, "this may be the distance from an older goal"
    handle.report(NODE, "started", "")
    for remaining, progress in ((2.0, 0.0), (4.0, 0.0), (1.0, 0.75), (0.0, 1.0)):
        handle.approach(remaining)
        assert handle.feedback.progress == pytest.approx(progress)
        assert handle.feedback.remaining == remaining
    handle.report(NODE, "paused", "")
    assert handle.feedback.state == "paused" and handle.feedback.remaining == 0.0


def test_the_progress_of_a_path_stays_within_0_and_1(link):
    link.handle.report(NODE, "started", "")
    for given, shown in ((-0.1, 0.0), (0.4, 0.4), (1.1, 1.0)):
        link.handle.advance(given)
        assert link.handle.feedback.progress == shown
    assert link.handle.feedback.remaining is None


def test_cancel_returns_the_end_that_the_node_confirms(link):
    link.tell(("started", ""), ("cancelled", "by a request"))
    assert link.handle.cancel() == MotionResult(Outcome.CANCELLED, "by a request")
    assert link.cancelled == [link.handle]


def test_a_motion_that_has_ended_is_not_cancelled(link):
    link.handle.report(NODE, "arrived", "")
    assert link.handle.cancel().outcome is Outcome.ARRIVED
    assert link.cancelled == []


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "did not confirm"),
        ((True, ""), "has not come to rest"),
        ((False, "nothing to cancel: idle"), "nothing to cancel: idle"),
    ],
)
def test_a_cancellation_that_is_not_confirmed_is_an_error_that_warns(link, answer, words):
    if answer is not None:
        link.script.append(lambda: link.handle.answer_cancel(*answer))
    with pytest.raises(RobotTimeoutError, match=words) as raised:
        link.handle.cancel(timeout=1.0)
    assert "the robot may go on" in str(raised.value)


def test_a_topic_that_was_never_heard_has_no_value():
    reading = Reading("odom")
    assert not reading.is_known and reading.age == float("inf")
    with pytest.raises(RobotError, match="'odom'"):
        _ = reading.value


def test_without_ros_a_robot_says_what_to_install():
    code = (
        "import sys; from omniman_ros.client.robot import Robot\n"
        "loaded = {name.split('.')[0] for name in sys.modules}\n"
        "assert not loaded & {'rclpy', 'numpy'}, loaded\n"
        "import importlib.util as u; find = u.find_spec\n"
        "import omniman_ros.extras as e\n"
        "e.find_spec = lambda name: None if name == 'rclpy' else find(name)\n"
        "from omniman_ros.client.state import RobotError\n"
        "try: Robot()\n"
        "except RobotError as error: print(error)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "omniman_ros[ros]" in run.stdout, run.stderr
