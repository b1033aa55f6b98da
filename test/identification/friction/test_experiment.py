import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.errors import InputError
from omniman_ros.identification.friction.experiment import ExperimentPhase, FrictionExperiment
from omniman_ros.identification.friction.feedback_monitor import AT_REST_SPEED
from omniman_ros.identification.friction.friction_fit import MIN_SPEED, identify_friction
from omniman_ros.identification.friction.level_samples import ExperimentError
from omniman_ros.identification.friction.voltage_plan import (
    TOP_FRACTION,
    balanced_signs,
    make_plan,
)
from test import robots

IG42 = robots.robot("ig42")
BACK_EMF = 0.0325 * 24
PERIOD = 0.01
START = 50.0


class Wheels:
    """Wheels without a plant: the speeds follow the steady ones with a lag, on counted time."""

    def __init__(self, robot=IG42, plan=None, lag=0.02, noise=0.0, seed=3, **options):
        self.robot, self.lag, self.noise = robot, lag, noise
        self.plan = plan or make_plan(robot, **options)
        self.n = robot.wheel_count
        self.now = START
        self.experiment = FrictionExperiment(robot, self.plan, self.now)
        self.rng = np.random.default_rng(seed)
        self.volts = np.zeros(self.n)
        self.speed, self.position = np.zeros(self.n), np.zeros(self.n)
        self.held, self.drift, self.report_factor = None, 0.0, 1.0
        self.silent = set()
        self.given, self.phases = [], []
        self.ticks = 0

    def current(self):
        motor, friction = self.robot.motor, self.robot.friction
        gain = motor.gear_efficiency * back_emf_of(self.robot)
        torque = friction.viscous * self.speed + friction.coulomb * np.sign(self.speed)
        current = torque / gain
        if self.held is not None:
            current[self.held] = self.volts[self.held] / motor.resistance
        return current + self.rng.normal(0.0, self.noise, self.n)

    def steady_speed(self):
        motor, friction = self.robot.motor, self.robot.friction
        gain = motor.gear_efficiency * back_emf_of(self.robot) / motor.resistance
        over = gain * np.abs(self.volts) - np.array(friction.coulomb)
        damping = gain * back_emf_of(self.robot) + np.array(friction.viscous)
        return np.sign(self.volts) * np.maximum(over, 0.0) / damping

    def step(self):
        self.now += PERIOD
        self.ticks += 1
        fraction = 1.0 - math.exp(-PERIOD / self.lag)
        self.speed = self.speed + fraction * (self.steady_speed() - self.speed)
        if self.held is not None:
            self.speed[self.held] = 0.0
        self.report_factor -= self.drift * PERIOD
        reported = self.speed * self.report_factor
        self.position = self.position + PERIOD * reported
        if "wheel_states" not in self.silent:
            self.experiment.on_wheels(self.now, self.position, reported, self.now)
        if self.ticks % 2 == 0 and "wheel_electrical" not in self.silent:
            self.experiment.on_electrical(self.volts, self.current(), self.now)
        self.volts = self.experiment.voltages(self.now)
        self.given.append(self.volts)
        self.phases.append(self.experiment.phase)

    def until(self, condition, most=2000.0):
        while not condition():
            assert self.now < START + most, f"{self.experiment.phase} at {self.volts}"
            self.step()
        return self

    def reach(self, phase, index=None):
        return self.until(
            lambda: self.experiment.phase is phase and index in (None, self.experiment.level_index)
        )

    def finish(self):
        return self.until(lambda: self.experiment.phase is ExperimentPhase.DONE)


def back_emf_of(robot):
    return robot.motor.torque_constant * robot.motor.gear_ratio


# ---- the plan --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", robots.ALL)
def test_a_plan_stays_within_the_robot_s_voltage_and_speed(name):
    robot = robots.robot(name)
    plan = make_plan(robot)
    motor, levels = robot.motor, np.array(plan.levels)
    assert len(levels) == 24
    top = np.abs(levels).max()
    assert top <= TOP_FRACTION * motor.max_voltage
    # without any friction it would turn at
    assert top / back_emf_of(robot) <= TOP_FRACTION * motor.max_speed * (1 + 1e-9)
    assert top == pytest.approx(
        TOP_FRACTION * min(motor.max_voltage, motor.max_speed * back_emf_of(robot))
    )
    forwards, backwards = levels[:6], levels[6:12]
    np.testing.assert_array_equal(forwards, -backwards)
    assert (np.diff(forwards) < 0).all(), "from the highest down"
    assert 0 < plan.check_level < 0.5 * top
    slowest = (forwards[-1]) / back_emf_of(robot)
    assert slowest > MIN_SPEED


@pytest.mark.parametrize("name", robots.ALL)
def test_the_signs_of_the_wheels_push_a_robot_on_the_floor_least(name):
    robot = robots.robot(name)
    signs = balanced_signs(robot)
    assert set(np.abs(signs).tolist()) == {1.0}
    jacobian = PlatformKinematics(robot.wheels).J
    force = np.linalg.norm(signs @ jacobian[:, :2])
    assert force <= np.linalg.norm(np.ones(len(signs)) @ jacobian[:, :2]) + 1e-9
    if name in robots.SHIPPED:
        np.testing.assert_allclose(signs @ jacobian, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"levels": 2}, "at least 3"),
        ({"rounds": 0}, "at least 3 levels in 1 round"),
        ({"precision": 0.0}, "precision"),
        ({"precision": math.nan}, "precision"),
        ({"feedback_timeout": 0.0}, "feedback timeout"),
        ({"feedback_timeout": math.nan}, "feedback timeout"),
    ],
)
def test_an_invalid_plan_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        make_plan(IG42, **options)


def test_a_robot_that_is_too_slow_is_refused():
    with pytest.raises(InputError, match="too slow"):
        make_plan(robots.robot("ig42", {"motor.max_speed": 3.0}))


# ---- the course of the experiment ------------------------------------------------------------


@pytest.mark.parametrize("name", ["ig42", "omniman", "omni3", "mecanum8"])
def test_all_levels_are_applied_with_ramps_and_measured(name):
    robot = robots.robot(name)
    wheels = Wheels(robot, levels=3, rounds=1).finish()
    plan = wheels.plan
    volts = np.vstack([np.zeros(wheels.n), wheels.given])
    assert np.abs(np.diff(volts, axis=0)).max() <= plan.ramp_rate * PERIOD * (1 + 1e-9)
    assert np.abs(volts).max() == pytest.approx(max(plan.levels))
    np.testing.assert_array_equal(volts[-1], 0.0)
    assert np.abs(wheels.speed).max() < AT_REST_SPEED
    runs = wheels.experiment.runs
    assert len(runs) == len(plan.levels) == 6
    for run, level in zip(runs, plan.levels, strict=True):
        np.testing.assert_allclose(run.voltage, level * plan.signs)
        assert run.steady.all()
        wheels.volts = run.voltage
        np.testing.assert_allclose(run.speed, wheels.steady_speed(), rtol=1e-3)
    for wheel, a, b in zip(
        identify_friction(runs, robot), robot.friction.viscous, robot.friction.coulomb, strict=True
    ):
        assert wheel.viscous.value == pytest.approx(a, rel=0.01, abs=1e-6)
        assert wheel.coulomb.value == pytest.approx(b, rel=0.01, abs=1e-6)
    assert wheels.experiment.fraction == 1.0


def test_it_waits_until_the_speed_is_constant():
    """With a lag of 0.4 s the speed is within a thousandth after 7 lags."""

    def waited(lag):
        wheels = Wheels(lag=lag).reach(ExperimentPhase.SETTLE, 0)
        start = wheels.now
        wheels.reach(ExperimentPhase.MEASURE, 0)
        return wheels.now - start, wheels

    quick, _ = waited(0.02)
    slow, wheels = waited(0.4)
    assert 0.5 <= quick < 1.0
    assert 1.2 < slow < wheels.plan.settle_timeout
    np.testing.assert_allclose(wheels.speed, wheels.steady_speed(), rtol=0.005)


def test_a_speed_that_never_settles_is_measured_after_the_timeout_and_marked():
    wheels = Wheels().reach(ExperimentPhase.SETTLE, 0)
    wheels.drift = 0.05  # 0.9 rad/s^2: a thirtieth of the friction's torque
    start = wheels.now
    wheels.reach(ExperimentPhase.MEASURE, 0)
    assert wheels.now - start == pytest.approx(wheels.plan.settle_timeout, abs=0.1)
    wheels.until(lambda: len(wheels.experiment.runs) == 1)
    assert not wheels.experiment.runs[0].steady.any()


def test_a_noisy_current_is_measured_longer_up_to_a_limit():
    def measured(noise):
        wheels = Wheels(noise=noise, precision=0.01).reach(ExperimentPhase.MEASURE, 0)
        start = wheels.now
        wheels.until(lambda: len(wheels.experiment.runs) == 1)
        run = wheels.experiment.runs[0]
        return wheels.now - start, run, wheels.plan

    quick, _, plan = measured(0.0)
    assert quick == pytest.approx(plan.min_measurement, abs=0.25)
    longer, run, plan = measured(0.06)
    assert plan.min_measurement + 1.0 < longer < 6.0  # 150 samples if the noise were known
    friction = 0.25 / (0.66 * BACK_EMF)
    assert (run.error <= 0.01 * 1.2 * friction).all()
    assert run.samples == pytest.approx(longer / 0.02, abs=25)
    longest, _, plan = measured(2.0)
    assert longest == pytest.approx(plan.max_measurement, abs=0.25)


# ---- faults -------------------------------------------------------------------------


@pytest.mark.parametrize("topic", ["wheel_states", "wheel_electrical"])
@pytest.mark.parametrize(
    "phase", [ExperimentPhase.RAMP, ExperimentPhase.SETTLE, ExperimentPhase.MEASURE]
)
def test_missing_feedback_ends_it_in_time(topic, phase):
    wheels = Wheels().reach(phase, 1)
    wheels.silent.add(topic)
    start = wheels.now
    with pytest.raises(ExperimentError, match=f"no {topic} for"):
        wheels.until(lambda: False, 500.0)
    assert wheels.now - start == pytest.approx(wheels.plan.feedback_timeout, abs=0.04)


def test_a_wheel_that_is_too_fast_ends_it():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 0)
    wheels.speed[2] = -20.5
    with pytest.raises(ExperimentError, match=r"'rear_left' turns at -\d+.*motor.max_speed = 20"):
        wheels.experiment.on_wheels(wheels.now + 1e-3, wheels.position, wheels.speed, wheels.now)
        wheels.experiment.voltages(wheels.now)


@pytest.mark.parametrize(("held", "name"), [(0, "front_left"), (3, "rear_right")])
def test_a_wheel_that_does_not_turn_ends_it_at_the_first_low_voltage(held, name):
    wheels = Wheels()
    wheels.held = held
    with pytest.raises(ExperimentError, match=f"'{name}' turns at 0.00 .* touch the floor"):
        wheels.until(lambda: False, 500.0)
    assert np.abs(wheels.given).max() <= wheels.plan.check_level * (1 + 1e-9)
    assert wheels.now - START < 2.5


def test_a_wheel_that_is_blocked_later_ends_it_too():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 8)
    wheels.held = 1
    start = wheels.now
    with pytest.raises(ExperimentError, match="'front_right'"):
        wheels.until(lambda: False, 500.0)
    assert wheels.now - start < 0.1


def test_a_wheel_that_turns_but_is_strained_ends_it():
    """Wheels that slip on the floor turn nearly as fast, and draw many times the current."""
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 0)
    for k in range(9):
        assert wheels.experiment.phase is ExperimentPhase.MEASURE
        amps = np.array([0.5, 5.0, 0.5, 0.5])
        wheels.now += 1e-3
        wheels.experiment.on_electrical(wheels.volts, amps, wheels.now)
        if k < 4:  # the median of nine is still small
            wheels.experiment.voltages(wheels.now)
    with pytest.raises(ExperimentError, match=r"'front_right' draws 5.00 A .* touch the floor"):
        wheels.experiment.voltages(wheels.now)


def test_stiction_at_the_lowest_voltage_is_no_fault():
    """More than twice the configured friction slows the wheels down at the lowest level only."""
    sticky = robots.robot("ig42", {"friction.coulomb": [0.6]})
    plan = replace(make_plan(IG42, levels=6, rounds=1), precision=0.05)
    wheels = Wheels(sticky, plan).finish()
    runs = wheels.experiment.runs
    assert np.abs(runs[5].speed).max() < MIN_SPEED < np.abs(runs[4].speed).min()
    for wheel in identify_friction(runs, IG42):
        assert wheel.left_out == (5, 11)
        assert wheel.coulomb.value == pytest.approx(0.6, rel=0.02)


def test_positions_and_velocities_must_agree():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 0)
    wheels.step()
    experiment = wheels.experiment
    with pytest.raises(ExperimentError, match="disagree with themselves"):
        for _ in range(500):
            wheels.now += PERIOD
            experiment.on_wheels(
                wheels.now,
                wheels.position + 0.8 * (wheels.now - START) * wheels.speed,
                wheels.speed,
                wheels.now,
            )
            experiment.on_electrical(wheels.volts, wheels.current(), wheels.now)
            experiment.voltages(wheels.now)


def delay(wheels, seconds, who):
    """Delay the commands or the feedback; the drives ramp to rest by themselves meanwhile."""
    for _ in range(round(seconds / PERIOD)):
        wheels.now += PERIOD
        step = np.minimum(9.0 * PERIOD, np.abs(wheels.speed))
        wheels.speed = wheels.speed - np.sign(wheels.speed) * step
        wheels.position = wheels.position + PERIOD * wheels.speed
        if who == "tool":  # its messages are queued
            wheels.experiment.on_wheels(
                wheels.now, wheels.position, wheels.speed, wheels.now + seconds
            )
        else:
            wheels.volts = wheels.experiment.voltages(wheels.now)


@pytest.mark.parametrize("who", ["tool", "drive"])
@pytest.mark.parametrize(
    "phase", [ExperimentPhase.RAMP, ExperimentPhase.SETTLE, ExperimentPhase.MEASURE]
)
def test_a_delayed_level_is_restarted_without_a_jump(who, phase):
    wheels = Wheels(levels=3, rounds=1, feedback_timeout=2.0).reach(phase, 1)
    delay(wheels, 0.7, who)
    speed = np.abs(wheels.speed)
    for _ in range(4):
        wheels.step()
    assert wheels.experiment.phase is ExperimentPhase.RAMP and wheels.experiment.level_index == 1
    assert wheels.experiment.restarts >= 1
    jump = np.abs(wheels.volts) - BACK_EMF * speed
    assert jump.max() < 1.0, "the voltages begin at the back-EMF"
    runs = wheels.finish().experiment.runs
    assert len(runs) == 6
    found = identify_friction(runs, IG42)[0]
    assert found.coulomb.value == pytest.approx(0.25, rel=0.01)


def test_wheels_of_a_drive_that_ramps_down_do_not_count_as_held():
    """After late commands the wheels may have lost most of their speed."""
    wheels = Wheels(levels=3, rounds=1).reach(ExperimentPhase.MEASURE, 0)
    wheels.speed *= 0.2
    wheels.experiment.on_electrical(0.2 * wheels.volts, wheels.current(), wheels.now)
    wheels.now += PERIOD
    wheels.experiment.on_wheels(wheels.now, wheels.position, wheels.speed, wheels.now)
    wheels.experiment.voltages(wheels.now)
    assert wheels.experiment.phase is ExperimentPhase.RAMP
    assert len(wheels.finish().experiment.runs) == 6


def test_a_drive_that_ramps_down_is_detected_while_the_speed_settles():
    wheels = Wheels(levels=3, rounds=1).reach(ExperimentPhase.SETTLE, 0)
    for _ in range(25):
        wheels.step()
    wheels.experiment.on_electrical(0.6 * wheels.volts, wheels.current(), wheels.now)
    wheels.experiment.voltages(wheels.now)
    assert wheels.experiment.phase is ExperimentPhase.RAMP and wheels.experiment.restarts == 1


def test_a_drive_that_gives_other_voltages_ends_it():
    wheels = Wheels(feedback_timeout=2.0)
    fair = wheels.experiment.on_electrical
    wheels.experiment.on_electrical = lambda volts, amps, now: fair(0.55 * volts, amps, now)
    with pytest.raises(
        ExperimentError, match=r"the drive of '\w+' gives .* V are commanded.*repeatedly"
    ):
        wheels.until(lambda: False, 500.0)
    assert wheels.experiment.restarts == 4


def test_a_machine_that_is_always_delayed_ends_it():
    wheels = Wheels(feedback_timeout=2.0)
    with pytest.raises(ExperimentError, match="is too slow"):
        for _ in range(100):
            wheels.reach(ExperimentPhase.SETTLE)
            delay(wheels, 0.2, "tool")
            wheels.step()
    assert wheels.experiment.restarts == 13


def test_a_pause_on_the_way_to_rest_counts_in_the_ramp():
    """The voltage from before the pause would accelerate wheels that the drives have stopped."""
    wheels = Wheels(feedback_timeout=2.0).reach(ExperimentPhase.MEASURE, 0)
    wheels.experiment.end(wheels.now)
    np.testing.assert_array_equal(wheels.experiment.voltages(wheels.now + 0.75), 0.0)


@pytest.mark.parametrize(
    ("stamp", "position", "velocity"),
    [
        (math.nan, [0.0] * 4, [0.0] * 4),
        (START, [0.0] * 4, [0.0] * 4),
        (99.0, [math.nan, 0, 0, 0], [0.0] * 4),
        (99.0, [0.0] * 4, [0, 0, math.inf, 0]),
        (99.0, [0.0] * 3, [0.0] * 4),
        (99.0, [0.0] * 4, [0.0] * 5),
    ],
)
def test_invalid_states_are_refused(stamp, position, velocity):
    experiment = FrictionExperiment(IG42, make_plan(IG42), START)
    experiment.on_wheels(START, np.zeros(4), np.zeros(4), START)
    with pytest.raises(InputError, match="wheel_states"):
        experiment.on_wheels(stamp, np.array(position), np.array(velocity), START)


@pytest.mark.parametrize("values", [[math.nan, 0, 0, 0], [0.0] * 3, [1e7, 0, 0, 0]])
def test_invalid_electrical_values_are_refused(values):
    experiment = FrictionExperiment(IG42, make_plan(IG42), START)
    for pair in ((values, [0.0] * 4), ([0.0] * 4, values)):
        with pytest.raises(InputError, match="wheel_electrical"):
            experiment.on_electrical(*map(np.array, pair), START)


# ---- the end -----------------------------------------------------------------------------


def test_an_early_end_ramps_down_and_keeps_the_runs():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 2)
    start, level = wheels.now, abs(wheels.volts[0])
    wheels.experiment.end(wheels.now)
    first = len(wheels.given)
    wheels.finish()
    volts = np.abs(np.array(wheels.given[first - 1 :])[:, 0])
    steps = -np.diff(volts)
    assert (steps >= 0).all() and steps.max() <= wheels.plan.stop_ramp_rate * PERIOD * (1 + 1e-9)
    assert wheels.now - start < level / wheels.plan.stop_ramp_rate + 1.0
    assert len(wheels.experiment.runs) == 2
    assert np.abs(wheels.speed).max() < AT_REST_SPEED


def test_drives_that_stop_by_themselves_receive_zero_at_once():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 2)
    wheels.experiment.end(wheels.now, at_once=True)
    np.testing.assert_array_equal(wheels.experiment.voltages(wheels.now), 0.0)


def test_after_a_fault_it_ramps_down_without_feedback_and_ends():
    wheels = Wheels().reach(ExperimentPhase.MEASURE, 0)
    wheels.silent = {"wheel_states", "wheel_electrical"}
    with pytest.raises(ExperimentError):
        wheels.until(lambda: False, 500.0)
    wheels.experiment.end(wheels.now)
    start = wheels.now
    wheels.finish()
    np.testing.assert_array_equal(wheels.given[-1], 0.0)
    assert wheels.now - start < 0.75 + 3.5
    wheels.experiment.end(wheels.now)
    assert wheels.experiment.phase is ExperimentPhase.DONE
