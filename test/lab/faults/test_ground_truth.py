from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.lab.faults.ground_truth import GroundTruth


class Reports:
    """Ground truth that gets its reports from the test, at instants in milliseconds."""

    def __init__(self, is_simulated=False):
        self._callbacks = {}
        self.truth = GroundTruth(SimpleNamespace(node=self, is_simulated=is_simulated))

    def create_subscription(self, kind, topic, callback, qos, event_callbacks=None):
        self._callbacks[topic] = callback
        return SimpleNamespace()

    def send(self, topic, message, at, sent):
        message.header.stamp = Time(sec=100, nanosec=at * 1_000_000)
        message_info = {"source_timestamp": 100_000_000_000 + sent * 1_000_000}
        self._callbacks[topic](message, message_info)

    def platform(self, at, sent):
        self.send("ground_truth/odom", Odometry(), at, sent)

    def arm(self, at, sent):
        message = JointState(position=[0.0] * 6, velocity=[0.0] * 6)
        self.send("ground_truth/arm_joint_states", message, at, sent)


@pytest.fixture
def reports():
    reports = Reports()
    for at in (0, 10, 20):
        reports.platform(at, at + 1)
        reports.arm(at, at + 4)
    return reports


def test_samples_count_at_the_instant_that_they_are_of(reports):
    assert reports.truth.platform[:, 0] == pytest.approx([100.0, 100.01, 100.02], abs=1e-6)
    assert reports.truth.longest_hold_up == pytest.approx(0.01, abs=1e-6)


def test_a_gap_between_reports_is_a_hold_up(reports):
    reports.arm(75, 79)
    assert reports.truth.longest_hold_up == pytest.approx(0.055, abs=1e-6)


def test_a_plant_that_is_behind_its_reports_is_held_up_until_they_are_forgotten(reports):
    reports.platform(21, 80)
    assert reports.truth.longest_hold_up == pytest.approx(0.059, abs=1e-6)
    reports.truth.clear()
    assert reports.truth.longest_hold_up == 0.0


def test_nothing_is_held_up_in_simulated_time():
    reports = Reports(is_simulated=True)
    reports.platform(21, 80)
    assert reports.truth.longest_hold_up == 0.0


def test_nothing_is_known_of_the_time_before_it_began_anew(reports):
    reports.truth.forget()
    assert reports.truth.pose is None and reports.truth.angles is None
    assert reports.truth.speeds == (0.0, 0.0)


def test_the_truth_is_known_up_to_an_instant_once_platform_and_arm_have_reached_it(reports):
    assert reports.truth.covers(100.02, arm=True)
    reports.platform(30, 31)
    assert not reports.truth.covers(100.03, arm=True)
    assert reports.truth.covers(100.03, arm=False)
    reports.arm(30, 31)
    assert reports.truth.covers(100.03, arm=True)


def test_nothing_is_known_before_the_first_report():
    assert not Reports().truth.covers(0.0, arm=True)


def test_a_report_that_is_read_late_is_old(reports, monkeypatch):
    monkeypatch.setattr("time.time", lambda: 103.5)
    reports.platform(30, 500)
    assert reports.truth.age == pytest.approx(3.0)
