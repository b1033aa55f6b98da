"""Measured against requested torque: a silent wheel is probed, one that stays silent is dead."""

import numpy as np
import pytest

from omniman_ros.control.dead_wheel import (
    PROBE_PAUSE,
    PROBE_SIGNS,
    DeadWheelDetector,
    Probe,
    WheelHealthParameters,
    torque_probe,
)
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from test.robots import ALL, kinematics

DT = 0.005
HEALTH = build(WheelHealthParameters, {})
LIMIT = 50.0
ASKED = 2.0


class Bench:
    """A detector with wheels whose reported torques `drive` computes from the requested ones."""

    def __init__(self, robot="omniman", drive=lambda asked: asked, noise=0.0, delay=0):
        self.model = kinematics(robot)
        n = self.model.wheel_count
        self.detector = DeadWheelDetector(np.full(n, LIMIT), HEALTH, self.model)
        self.drive, self.noise = drive, noise
        self.random = np.random.default_rng(1)
        self.underway = [np.zeros(n)] * (1 + delay)
        self.now, self.probes = 0.0, 0

    def tick(self, asked, reference, error=0.0):
        self.now += DT
        self.detector.update_torques(
            self.now, self.underway.pop(0) + self.random.normal(0.0, self.noise, len(asked))
        )
        had = self.detector.probe(self.now) is not None
        errors = np.full(len(asked), error)
        dead = self.detector.update(asked, reference, errors, self.now, DT)
        probe = self.detector.probe(self.now)
        self.probes += probe is not None and not had
        self.underway.append(self.drive(asked if probe is None else asked + probe))
        return dead

    def run(self, seconds, asked=None, reference=None, error=0.0):
        """Return the names of the dead wheels and the time of detection [s], or None."""
        n = self.model.wheel_count
        asked = np.full(n, ASKED) if asked is None else asked
        reference = np.full(n, 3.0) if reference is None else reference
        start = self.now
        for _ in range(round(seconds / DT)):
            dead = self.tick(asked, reference, error)
            if dead:
                return dead, self.now - start
        return None


def without(*wheels):
    """Return a drive in which some motors give no torque."""

    def drive(torque):
        given = np.array(torque)
        given[list(wheels)] = 0.0
        return given

    return drive


@pytest.mark.parametrize("robot", ALL)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_motor_without_torque_is_detected_within_a_second(robot, noise):
    for wheel in range(kinematics(robot).wheel_count):
        bench = Bench(robot, noise=noise)
        assert bench.run(1.0) is None
        assert bench.probes == 0
        bench.drive = without(wheel)
        dead, after = bench.run(1.5)
        assert dead == (wheel,)
        assert after < 1.0


def test_idling_wheel_that_answers_the_probe_is_not_probed_again_soon():
    bench = Bench(drive=lambda torque: torque - np.array([0.0, ASKED, 0.0, 0.0]))
    assert bench.run(9.0) is None
    assert 2 <= bench.probes <= 9.0 / PROBE_PAUSE


def test_dead_wheel_is_reported_and_not_an_idling_neighbour():
    idling = np.array([0.0, ASKED, 0.0, 0.0])
    bench = Bench(drive=lambda torque: without(0)(torque - idling))
    bench.run(1.0, np.zeros(4))
    bench.detector.update_torques(bench.now + 1e-4, np.array([0.0, 0.0, 5.0, 5.0]))
    assert bench.run(2.0)[0] == (0,)


def test_several_dead_wheels_are_detected_together():
    assert Bench(drive=without(0, 1, 2)).run(2.0)[0] == (0, 1, 2)


def test_wheel_spinning_on_ice_gives_friction_torque_and_is_not_dead():
    """Its speed loop cancels the probe at once: it does not answer, but it is not silent."""
    bench = Bench(drive=lambda torque: np.full(4, 0.02 * LIMIT))
    assert bench.run(5.0) is None


def test_wheel_on_ice_that_answers_briefly_is_not_dead():
    """Its speed loop cancels each step of the probe at once; it turns with or without friction."""
    before = np.full(4, ASKED)

    def drive(torque):
        nonlocal before
        given = np.array(torque)
        given[1] -= before[1]
        before = torque
        return given

    bench = Bench(drive=drive)
    bench.detector.update_torques(0.0, np.full(4, ASKED))
    assert bench.run(5.0) is None
    assert bench.probes >= 2


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_torque_is_expected_of_a_braking_or_standing_wheel(sign):
    n = 4
    bench = Bench(drive=without(0))
    speed = np.full(n, 3.0 * sign)
    assert bench.run(3.0, -sign * np.full(n, ASKED), speed) is None
    assert bench.run(3.0, sign * np.full(n, ASKED), np.full(n, 0.0)) is None
    assert bench.probes == 0
    assert bench.run(3.0, sign * np.full(n, ASKED), speed)[0] == (0,)


@pytest.mark.parametrize("error", [-1.0, 1.0])
@pytest.mark.parametrize("reference", [3.0, 0.0])
def test_braking_or_standing_wheel_that_does_not_follow_is_probed(reference, error):
    n = 4
    speed, braking = np.full(n, reference), -np.full(n, ASKED)
    bench = Bench(drive=without(0))
    assert bench.run(3.0, braking, speed, 0.1 * error) is None
    assert bench.run(2.0, braking, speed, error)[0] == (0,)
    healthy = Bench(drive=lambda torque: torque - np.array([-ASKED, 0.0, 0.0, 0.0]))
    healthy.detector.update_torques(0.0, braking)
    assert healthy.run(5.0, braking, speed, error) is None
    assert healthy.probes >= 2


def test_turning_dead_wheel_with_little_requested_torque_is_detected_later():
    bench = Bench(drive=without(0))
    little = np.array([0.3 * HEALTH.asked_torque * LIMIT, ASKED, ASKED, ASKED])
    dead, after = bench.run(3.0, little)
    assert dead == (0,)
    assert 1.0 < after < 2.0
    alone = Bench("omni3", drive=without(0))
    alone.detector.update_torques(0.0, np.full(3, ASKED))
    assert alone.run(3.0, little[:3]) is None, "three wheels give the requested torque"


def test_probe_is_dropped_when_its_wheel_brakes_or_no_source_drives():
    for end in (
        lambda bench: bench.tick(-np.full(4, ASKED), np.ones(4)),
        lambda bench: bench.detector.rest(),
    ):
        bench = Bench(drive=without(0))
        bench.detector.update_torques(bench.now, np.full(4, ASKED))
        while bench.detector.probe(bench.now) is None:
            bench.tick(np.full(4, ASKED), np.ones(4))
        end(bench)
        assert bench.detector.probe(bench.now) is None


def test_wheel_that_brakes_repeatedly_is_not_probed_continuously():
    bench = Bench(drive=without(0))
    bench.detector.update_torques(bench.now, np.full(4, ASKED))
    for k in range(600):
        brakes = k % 6 == 0
        assert not bench.tick(np.full(4, -ASKED if brakes else ASKED), np.full(4, 3.0))
    assert 2 < bench.probes <= 600 * DT / HEALTH.suspicion_time


@pytest.mark.parametrize("delay", [0, 4, 8])
def test_delayed_torques_cause_no_false_detection(delay):
    bench = Bench(drive=lambda torque: torque - np.array([0.0, ASKED, 0.0, 0.0]), delay=delay)
    assert bench.run(5.0) is None
    assert Bench(drive=without(2), delay=delay).run(2.0)[0] == (2,)


def test_missing_or_all_zero_torques_count_as_not_reported():
    detector = DeadWheelDetector(np.full(4, LIMIT), HEALTH, kinematics())
    asked, speed = np.full(4, ASKED), np.full(4, 3.0)
    nan = np.array([1.0, 2.0, np.nan, 1.0])
    for effort in (None, np.zeros(4), nan):
        for k in range(400):
            detector.update_torques(k * DT, effort)
            assert detector.update(asked, speed, 0.0 * speed, k * DT, DT) == ()
            assert detector.probe(k * DT) is None
        assert not detector.reported
    detector.update_torques(10.0, asked)
    assert detector.reported


def test_occasional_reports_without_torques_do_not_hide_a_dead_wheel():
    bench = Bench(drive=without(2))
    update_torques = bench.detector.update_torques

    def losing(time, effort):
        update_torques(time, None if round(time / DT) % 11 == 0 else effort)

    bench.detector.update_torques = losing
    assert bench.run(2.0)[0] == (2,)


@pytest.mark.parametrize("robot", ALL)
def test_probe_acts_along_the_constraints_where_they_exist(robot):
    model = kinematics(robot)
    for wheel in range(model.wheel_count):
        torque = torque_probe(model, wheel, 2.0)
        assert torque[wheel] == pytest.approx(2.0)
        if model.constraint_count:
            np.testing.assert_allclose(model.J.T @ torque, 0.0, atol=1e-9)
        else:
            assert np.count_nonzero(torque) == 1


def test_probe_sums_to_zero_and_needs_reports_in_each_part():
    probe = Probe(np.array([1.0, -1.0, 0.2]), 10.0, 0.05)
    times = 10.0 + DT * (0.5 + np.arange(40))
    total = sum(probe.torque(time) for time in times)
    np.testing.assert_allclose(total, 0.0, atol=1e-12)
    assert not probe.torque(10.0 + 0.05 * len(PROBE_SIGNS) + 1e-9).any()
    assert probe.judged.tolist() == [True, True, False]
    assert probe.response() is None
    for time in times[:30]:
        probe.update_torques(time, probe.torque(time))
    assert probe.response() is None
    for time in times[30:]:
        probe.update_torques(time, probe.torque(time))
    assert probe.is_over(10.2001) and not probe.is_over(10.1999)
    np.testing.assert_allclose(probe.response(), [1.0, 1.0, 0.2])


@pytest.mark.parametrize("name", ["asked_torque", "probe_torque"])
def test_thresholds_below_the_silence_threshold_are_rejected(name):
    with pytest.raises(ParameterError, match=name):
        build(WheelHealthParameters, {name: 0.004})
