"""Torques against what is asked for: who is silent is asked, who stays silent is dead."""

import numpy as np
import pytest
from robots import ALL, kinematics

from omniman_ros.core.dead_wheel import (
    PAUSE,
    SIGNS,
    DeadWheelDetector,
    Probe,
    WheelHealthParameters,
    torque_probe,
)
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build

DT = 0.005
HEALTH = build(WheelHealthParameters, {})
LIMIT = 50.0
ASKED = 2.0


class Bench:
    """A detector, and wheels that are asked for a torque and give what `drive` makes of it."""

    def __init__(self, robot="omniman", drive=lambda asked: asked, noise=0.0, delay=0):
        self.model = kinematics(robot)
        n = self.model.wheel_count
        self.detector = DeadWheelDetector(np.full(n, LIMIT), HEALTH, self.model)
        self.drive, self.noise = drive, noise
        self.random = np.random.default_rng(1)
        self.underway = [np.zeros(n)] * (1 + delay)
        self.now, self.probes = 0.0, 0

    def tick(self, asked, reference):
        self.now += DT
        self.detector.hear(
            self.now, self.underway.pop(0) + self.random.normal(0.0, self.noise, len(asked))
        )
        had = self.detector.probe(self.now) is not None
        dead = self.detector.update(asked, reference, self.now, DT)
        probe = self.detector.probe(self.now)
        self.probes += probe is not None and not had
        self.underway.append(self.drive(asked if probe is None else asked + probe))
        return dead

    def run(self, seconds, asked=None, reference=None):
        """Names of the dead and when they were found [s], or None."""
        n = self.model.wheel_count
        asked = np.full(n, ASKED) if asked is None else asked
        reference = np.full(n, 3.0) if reference is None else reference
        start = self.now
        for _ in range(round(seconds / DT)):
            dead = self.tick(asked, reference)
            if dead:
                return dead, self.now - start
        return None


def without(*wheels):
    """A drive of which some motors give nothing."""

    def drive(torque):
        given = np.array(torque)
        given[list(wheels)] = 0.0
        return given

    return drive


@pytest.mark.parametrize("robot", ALL)
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_motor_without_torque_is_found_within_a_second(robot, noise):
    for wheel in range(kinematics(robot).wheel_count):
        bench = Bench(robot, noise=noise)
        assert bench.run(1.0) is None
        assert bench.probes == 0
        bench.drive = without(wheel)
        dead, after = bench.run(1.5)
        assert dead == (wheel,)
        assert after < 1.0


def test_a_wheel_that_idles_by_chance_answers_and_is_left_alone_for_a_while():
    bench = Bench(drive=lambda torque: torque - np.array([0.0, ASKED, 0.0, 0.0]))
    assert bench.run(9.0) is None
    assert 2 <= bench.probes <= 9.0 / PAUSE


def test_the_dead_one_is_blamed_and_not_the_one_that_idles_beside_it():
    idling = np.array([0.0, ASKED, 0.0, 0.0])
    bench = Bench(drive=lambda torque: without(0)(torque - idling))
    bench.run(1.0, np.zeros(4))
    bench.detector.hear(bench.now + 1e-4, np.array([0.0, 0.0, 5.0, 5.0]))
    assert bench.run(2.0)[0] == (0,)


def test_several_dead_wheels_are_found_together():
    assert Bench(drive=without(0, 1, 2)).run(2.0)[0] == (0, 1, 2)


def test_a_wheel_that_spins_on_ice_gives_its_friction_and_is_not_dead():
    """Its loop takes the probe back at once: there is no answer, but no silence either."""
    bench = Bench(drive=lambda torque: np.full(4, 0.02 * LIMIT))
    assert bench.run(5.0) is None


def test_a_wheel_on_ice_that_answers_for_a_moment_is_not_dead():
    """Its loop takes each step of the probe back at once; the ice turns it, friction or not."""
    before = np.full(4, ASKED)

    def drive(torque):
        nonlocal before
        given = np.array(torque)
        given[1] -= before[1]
        before = torque
        return given

    bench = Bench(drive=drive)
    bench.detector.hear(0.0, np.full(4, ASKED))
    assert bench.run(5.0) is None
    assert bench.probes >= 2


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_nothing_is_expected_of_a_wheel_that_brakes_or_stands(sign):
    n = 4
    bench = Bench(drive=without(0))
    speed = np.full(n, 3.0 * sign)
    assert bench.run(3.0, -sign * np.full(n, ASKED), speed) is None
    assert bench.run(3.0, sign * np.full(n, ASKED), np.full(n, 0.0)) is None
    assert bench.probes == 0
    assert bench.run(3.0, sign * np.full(n, ASKED), speed)[0] == (0,)


def test_a_turning_wheel_of_which_little_is_asked_is_found_too_but_later():
    bench = Bench(drive=without(0))
    little = np.array([0.3 * HEALTH.asked_torque * LIMIT, ASKED, ASKED, ASKED])
    dead, after = bench.run(3.0, little)
    assert dead == (0,)
    assert 1.0 < after < 2.0
    alone = Bench("omni3", drive=without(0))
    alone.detector.hear(0.0, np.full(3, ASKED))
    assert alone.run(3.0, little[:3]) is None, "three wheels give what they are asked for"


def test_a_probe_is_dropped_when_its_wheel_begins_to_brake_and_when_nobody_drives():
    for end in (lambda bench: bench.tick(-np.full(4, ASKED), np.ones(4)),
                lambda bench: bench.detector.rest()):  # fmt: skip
        bench = Bench(drive=without(0))
        bench.detector.hear(bench.now, np.full(4, ASKED))
        while bench.detector.probe(bench.now) is None:
            bench.tick(np.full(4, ASKED), np.ones(4))
        end(bench)
        assert bench.detector.probe(bench.now) is None


def test_a_wheel_that_brakes_time_and_again_is_not_asked_all_the_time():
    bench = Bench(drive=without(0))
    bench.detector.hear(bench.now, np.full(4, ASKED))
    for k in range(600):
        brakes = k % 6 == 0
        assert not bench.tick(np.full(4, -ASKED if brakes else ASKED), np.full(4, 3.0))
    assert 2 < bench.probes <= 600 * DT / HEALTH.suspicion_time


@pytest.mark.parametrize("delay", [0, 4, 8])
def test_late_torques_mislead_nobody(delay):
    bench = Bench(drive=lambda torque: torque - np.array([0.0, ASKED, 0.0, 0.0]), delay=delay)
    assert bench.run(5.0) is None
    assert Bench(drive=without(2), delay=delay).run(2.0)[0] == (2,)


def test_without_torques_or_with_zeros_only_nothing_is_said():
    detector = DeadWheelDetector(np.full(4, LIMIT), HEALTH, kinematics())
    asked, speed = np.full(4, ASKED), np.full(4, 3.0)
    nan = np.array([1.0, 2.0, np.nan, 1.0])
    for effort in (None, np.zeros(4), nan):
        for k in range(400):
            detector.hear(k * DT, effort)
            assert detector.update(asked, speed, k * DT, DT) == ()
            assert detector.probe(k * DT) is None
        assert not detector.reported
    detector.hear(10.0, asked)
    assert detector.reported


def test_a_report_without_torques_now_and_then_hides_no_dead_wheel():
    bench = Bench(drive=without(2))
    hear = bench.detector.hear

    def losing(time, effort):
        hear(time, None if round(time / DT) % 11 == 0 else effort)

    bench.detector.hear = losing
    assert bench.run(2.0)[0] == (2,)


@pytest.mark.parametrize("robot", ALL)
def test_a_probe_is_along_the_constraints_where_there_are_any(robot):
    model = kinematics(robot)
    for wheel in range(model.wheel_count):
        torque = torque_probe(model, wheel, 2.0)
        assert torque[wheel] == pytest.approx(2.0)
        if model.constraint_count:
            np.testing.assert_allclose(model.J.T @ torque, 0.0, atol=1e-9)
        else:
            assert np.count_nonzero(torque) == 1


def test_a_probe_adds_up_to_nothing_and_needs_reports_in_each_part():
    probe = Probe(np.array([1.0, -1.0, 0.2]), 10.0, 0.05)
    times = 10.0 + DT * (0.5 + np.arange(40))
    total = sum(probe.torque(time) for time in times)
    np.testing.assert_allclose(total, 0.0, atol=1e-12)
    assert not probe.torque(10.0 + 0.05 * len(SIGNS) + 1e-9).any()
    assert probe.asks.tolist() == [True, True, False]
    assert probe.answer() is None
    for time in times[:30]:
        probe.hear(time, probe.torque(time))
    assert probe.answer() is None
    for time in times[30:]:
        probe.hear(time, probe.torque(time))
    assert probe.over(10.2001) and not probe.over(10.1999)
    np.testing.assert_allclose(probe.answer(), [1.0, 1.0, 0.2])


@pytest.mark.parametrize("name", ["asked_torque", "probe_torque"])
def test_thresholds_below_silence_are_refused(name):
    with pytest.raises(ParameterError, match=name):
        build(WheelHealthParameters, {name: 0.004})
