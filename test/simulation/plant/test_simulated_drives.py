"""The public interface of the simulated drives."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.simulation.plant.drive_unit import DriveUnitMode
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from test.simulation.plant.support import parameters, robot
from test.tiers import combinations, representative

ROBOTS = ["ig42", "omniman", "omni3", "mecanum6", "mecanum8", "skewed4"]


class Rig:
    """Drives with their own clock."""

    def __init__(self, name="ig42", seed=0, changes=None, start=0.0, **settings):
        self.robot = robot(name, **(changes or {}))
        self.drives = SimulatedDrives(self.robot, parameters(**settings), seed)
        self.now = start
        self.n = self.robot.wheel_count
        self.drives.advance(start)

    def speeds(self):
        """Return the true wheel speeds."""
        return np.array([wheel.speed for wheel in self.drives._plant.wheels])

    def run(self, seconds, each=None, period=0.01):
        """Advance time, call `each` at every period and return the true speeds."""
        seen = []
        for _ in range(round(seconds / period)):
            if each:
                each()
            self.now += period
            self.drives.advance(self.now)
            seen.append(self.speeds())
        return np.array(seen)

    def velocity(self, seconds, speed, effort=None):
        """Command a velocity at every period."""
        speeds = np.broadcast_to(np.asarray(speed, dtype=float), self.n)
        return self.run(seconds, lambda: self.drives.command_velocity(speeds, effort, self.now))

    def voltage(self, seconds, volts):
        """Command voltages at every period."""
        levels = np.broadcast_to(np.asarray(volts, dtype=float), self.n)
        return self.run(seconds, lambda: self.drives.command_voltage(levels, self.now))

    def torque(self, seconds, effort):
        """Command torques at every period."""
        efforts = np.broadcast_to(np.asarray(effort, dtype=float), self.n)
        return self.run(seconds, lambda: self.drives.command_torque(efforts, self.now))


# velocity mode


@pytest.mark.parametrize("name", ROBOTS)
def test_wheels_reach_the_speeds_of_the_desired_body_motion(name):
    rig = Rig(name)
    rows = np.array(
        [np.array(wheel.axis.row) / wheel.axis.arm for wheel in rig.drives._plant.wheels]
    )
    wanted = np.array([0.3, 0.1, 0.1])  # of the centre of mass
    target = rows @ wanted
    for k in range(300):
        speeds = target * min(1.0, k / 100)
        rig.run(0.01, lambda speeds=speeds: rig.drives.command_velocity(speeds, None, rig.now))
    np.testing.assert_allclose(rig.speeds(), target, atol=0.06)
    plant = rig.drives._plant
    _, twist = rig.drives.ground_truth()
    x, y = plant._offset
    com = twist + twist[2] * np.array([-y, x, 0.0])
    np.testing.assert_allclose(com, wanted, atol=0.01)


@pytest.mark.parametrize(
    ("name", "speed"), combinations(["ig42", "omniman"], [0.3, 1.0, 3.0, 6.0])
)
def test_velocity_loop_settles_on_the_setpoint(name, speed):
    rig = Rig(name)
    seen = rig.velocity(2.0, speed)
    np.testing.assert_allclose(seen[100:].mean(axis=0), speed, rtol=0.01)
    assert seen.max() < 1.25 * speed + 0.3
    states = rig.drives.wheel_states(rig.now)
    np.testing.assert_allclose(states.velocity, speed, rtol=0.05)


def test_voltage_and_current_stay_within_their_limits():
    rig = Rig("omniman")
    for speed in (14.0, -14.0, 0.0, 14.0):
        for _ in range(30):
            rig.velocity(0.01, speed)
            voltage, current, _ = rig.drives.electrical().T
            assert np.abs(voltage).max() <= 48.0
            assert np.abs(current).max() <= 25.0 + 1e-9


# torque and voltage mode


def test_torque_mode_produces_the_commanded_torque():
    changes = {"friction__coulomb": [0.0], "friction__viscous": [0.0]}
    rig = Rig("omniman", changes=changes, plant__lifted=True)
    rig.torque(0.05, [0.4, -0.4, 0.2, 0.1])
    before = rig.speeds()
    rig.torque(0.2, [0.4, -0.4, 0.2, 0.1])
    acceleration = (rig.speeds() - before) / 0.2
    np.testing.assert_allclose(acceleration, np.array([0.4, -0.4, 0.2, 0.1]) / 0.08, rtol=0.05)
    effort = rig.drives.wheel_states(rig.now).effort
    np.testing.assert_allclose(effort, [0.4, -0.4, 0.2, 0.1], atol=0.02)
    assert rig.drives.mode is DriveUnitMode.TORQUE


def test_voltage_mode_applies_and_clips_the_voltage():
    rig = Rig("ig42")
    rig.voltage(0.1, [3.0, -30.0, 0.0, 5.0])
    np.testing.assert_allclose(rig.drives.electrical()[:, 0], [3.0, -24.0, 0.0, 5.0])
    assert rig.drives.mode is DriveUnitMode.VOLTAGE


# watchdog and stop


@pytest.mark.parametrize(
    ("name", "mode"), combinations(["ig42", "omniman", "omni3"], ["velocity", "torque", "voltage"])
)
def test_silence_brings_the_wheels_to_rest_and_keeps_them_at_rest(name, mode):
    rig = Rig(name)
    rig.velocity(1.2, 4.0)
    if mode == "torque":
        rig.torque(0.2, rig.drives.wheel_states(rig.now).effort)
    elif mode == "voltage":
        rig.voltage(0.3, rig.drives.electrical()[:, 0])
    speed = np.abs(rig.speeds()).max()
    assert speed > 2.0
    assert not rig.drives.holding
    last = rig.now - 0.01
    rig.run(last + 0.099 - rig.now, period=0.001)
    assert not rig.drives.holding
    moving = rig.speeds()
    rig.run(0.003, period=0.001)
    assert rig.drives.holding
    assert rig.drives.mode is DriveUnitMode.VELOCITY
    seen = rig.run(speed / 10.0 / 2, period=0.001)
    # half way down the ramp
    np.testing.assert_allclose(seen[-1], moving - np.sign(moving) * speed / 2, atol=0.9)
    rig.run(speed / 10.0 / 2 + 0.35)
    rest = rig.run(1.0)
    assert np.abs(rest).max() == 0.0
    assert np.abs(rig.drives.ground_truth()[1]).max() < 1e-6
    # the next command drives again
    rig.velocity(1.0, 2.0)
    np.testing.assert_allclose(rig.speeds(), 2.0, atol=0.2)


def test_watchdog_acts_exactly_after_its_timeout():
    rig = Rig(firmware__watchdog=0.3)
    rig.velocity(1.0, 4.0)
    rig.run(0.28)
    assert not rig.drives.holding
    rig.run(0.02)
    assert rig.drives.holding


@pytest.mark.parametrize(
    "bad", [[1.0], [1.0] * 5, [math.nan] * 4, [0.0, 0.0, math.inf, 0.0]], ids=str
)
def test_rejected_command_causes_no_motion_and_feeds_no_watchdog(bad):
    rig = Rig()
    for _ in range(30):
        for command in (
            lambda: rig.drives.command_velocity(bad, None, rig.now),
            lambda: rig.drives.command_velocity([1.0] * 4, bad, rig.now),
            lambda: rig.drives.command_torque(bad, rig.now),
            lambda: rig.drives.command_voltage(bad, rig.now),
        ):
            with pytest.raises(InputError):
                command()
        rig.run(0.01)
    assert not rig.speeds().any()
    rig.velocity(0.5, 3.0)

    def refused():
        with pytest.raises(InputError):
            rig.drives.command_velocity(bad, None, rig.now)

    rig.run(1.5, refused)
    assert not rig.speeds().any()
    assert rig.drives.holding


def test_stop_is_quick_and_latched_until_a_reset_that_starts_no_motion():
    rig = Rig("omniman")
    rig.velocity(1.5, 6.0)
    rig.drives.stop("test")
    assert rig.drives.stop_reason == "test"
    rig.drives.stop("another")
    assert rig.drives.stop_reason == "test"
    seen = rig.velocity(0.2, 6.0)
    np.testing.assert_allclose(seen[-1], 6.0 - 9.0 * 0.2, atol=0.7)
    rig.velocity(0.8, 6.0)
    assert not rig.speeds().any()
    rig.voltage(0.2, 20.0)
    rig.torque(0.2, 5.0)
    assert not rig.speeds().any()
    rig.drives.reset()
    assert rig.drives.stop_reason is None
    rig.run(0.5)
    assert not rig.speeds().any()
    assert rig.drives.holding
    rig.velocity(1.0, 2.0)
    np.testing.assert_allclose(rig.speeds(), 2.0, atol=0.1)


# time


def test_motion_does_not_depend_on_the_query_rate():
    rigs = [Rig("ig42"), Rig("ig42")]
    for rig, period in zip(rigs, (0.05, 0.0003), strict=True):
        rig.drives.command_voltage([6.0, 5.0, 4.0, 5.0], 0.0)
        while rig.now < 0.0999:
            rig.now = min(rig.now + period, 0.1)
            rig.drives.advance(rig.now)
        rig.drives.advance(0.1)
    np.testing.assert_array_equal(rigs[0].drives.ground_truth(), rigs[1].drives.ground_truth())


def test_earlier_time_changes_nothing_and_non_finite_time_is_rejected():
    rig = Rig()
    rig.velocity(0.5, 3.0)
    before = rig.drives.ground_truth()
    rig.drives.advance(rig.now - 0.3)
    np.testing.assert_array_equal(rig.drives.ground_truth(), before)
    for bad in (math.nan, math.inf):
        with pytest.raises(InputError):
            rig.drives.advance(bad)


def test_drives_are_at_rest_after_a_long_gap_and_simulate_again():
    rig = Rig()
    rig.velocity(1.0, 5.0)
    rig.now += 1e6
    rig.drives.advance(rig.now)
    assert rig.drives._wheels.steps < 10_000
    assert not rig.speeds().any()
    rig.velocity(1.0, 3.0)
    np.testing.assert_allclose(rig.speeds(), 3.0, atol=0.1)


def test_equal_seeds_give_equal_runs():
    def run(seed):
        rig = Rig("ig42", seed=seed, faults__current_noise=0.5)
        rig.velocity(0.5, 3.0)
        return np.concatenate([rig.drives.electrical().ravel(), *rig.drives.ground_truth()])

    np.testing.assert_array_equal(run(4), run(4))
    assert np.abs(run(4) - run(5)).max() > 1e-6


# feedback


def test_true_pose_can_be_set():
    rig = Rig()
    rig.drives.set_pose([1.0, -2.0, 0.5])
    np.testing.assert_allclose(rig.drives.ground_truth()[0], [1.0, -2.0, 0.5])
    rig.velocity(1.0, 3.0)
    pose = rig.drives.ground_truth()[0]
    assert math.atan2(pose[1] + 2.0, pose[0] - 1.0) == pytest.approx(0.5, abs=1e-3)
    for bad in ([0.0, 0.0], [math.nan, 0.0, 0.0]):
        with pytest.raises(InputError):
            rig.drives.set_pose(bad)


# faults and live parameters


def test_dead_motor_gives_no_torque_and_draws_no_current():
    rig = Rig(
        faults__dead_motor=["front_left"], plant__lifted=True, firmware__encoder_tolerance=1e3
    )
    rig.velocity(0.5, 3.0)
    assert rig.speeds()[0] == 0.0
    assert rig.speeds()[1:].min() > 2.5
    np.testing.assert_array_equal(rig.drives.electrical()[0], 0.0)


def test_stuck_wheel_stands_still():
    rig = Rig()
    rig.velocity(1.0, 3.0)
    rig.drives.set_parameters(parameters(faults__stuck_wheel=["rear_right"]))
    rig.velocity(0.5, 3.0)
    assert rig.speeds()[3] == 0.0
    rig.drives.set_parameters(parameters())
    rig.velocity(1.0, 3.0)
    np.testing.assert_allclose(rig.speeds(), 3.0, atol=0.2)


def test_frozen_encoder_repeats_its_report_and_misleads_its_loop():
    rig = Rig("omniman", firmware__encoder_tolerance=1e3)
    rig.velocity(1.0, 3.0)
    frozen = parameters(faults__frozen_encoder=["front_right"], firmware__encoder_tolerance=1e3)
    rig.drives.set_parameters(frozen)
    before = rig.drives.wheel_states(rig.now)
    rig.velocity(1.0, 4.0)
    after = rig.drives.wheel_states(rig.now)
    assert after.position[1] == before.position[1]
    assert after.velocity[1] == before.velocity[1]
    assert rig.speeds()[1] > 4.5  # its loop still sees 3 rad/s


@pytest.mark.parametrize("lifted", [False, True])
def test_lost_encoder_stops_all_wheels_until_a_reset(lifted):
    rig = Rig("ig42", plant__lifted=lifted)
    rig.velocity(1.0, 3.0)
    broken = {"faults__frozen_encoder": ["front_right"], "plant__lifted": lifted}
    rig.drives.set_parameters(parameters(**broken))
    rig.torque(0.5, 1.2)  # torque enough for 10 rad/s^2 and more
    assert rig.drives.stop_reason == "encoder or motor lost: front_right"
    rig.torque(1.5, 1.2)
    assert np.abs(rig.speeds()).max() < 0.02
    rig.drives.set_parameters(parameters(plant__lifted=lifted))
    rig.torque(0.2, 1.0)
    assert rig.drives.stop_reason is not None
    rig.drives.reset()
    rig.velocity(1.0, 3.0)
    np.testing.assert_allclose(rig.speeds(), 3.0, atol=0.2)


@pytest.mark.parametrize(
    ("noise", "mode"), combinations([0.2, 0.0], ["velocity", "torque", "voltage"])
)
def test_open_motor_circuit_switches_off_only_its_drive_until_a_reset(mode, noise):
    """The motor can neither drive nor brake nor run away and does not stop the other drives."""
    rig = Rig("ig42", faults__current_noise=noise)
    rig.velocity(1.0, 3.0)
    broken = parameters(faults__dead_motor=["front_right"], faults__current_noise=noise)
    rig.drives.set_parameters(broken)
    {"velocity": rig.velocity, "torque": rig.torque, "voltage": rig.voltage}[mode](
        1.0, {"velocity": 6.0, "torque": 0.6, "voltage": 12.0}[mode]
    )
    assert rig.drives.stop_reason is None
    units = rig.drives._wheels.units
    assert [unit.open_circuit for unit in units] == [False, True, False, False]
    assert units[1].voltage == 0.0
    assert (
        rig.speeds()[[0, 2, 3]].min() > 2.5
    )  # the other wheels continue, although the robot yaws
    rig.drives.set_parameters(parameters())
    rig.velocity(1.0, 3.0)
    assert units[1].voltage == 0.0
    rig.drives.reset()
    rig.velocity(1.0, 3.0)
    assert not units[1].open_circuit and units[1].voltage > 1.0
    np.testing.assert_allclose(rig.speeds(), 3.0, atol=0.2)


def test_current_noise_is_measured_but_does_not_change_the_energy_meter():
    rig = Rig("ig42", faults__current_noise=0.2)
    currents = []
    rig.run(1.0, lambda: currents.append(rig.drives.electrical()[:, 1]), period=0.001)
    assert np.std(currents) == pytest.approx(0.2, rel=0.1)
    assert abs(rig.drives.energy.residual) <= 1e-9 * max(rig.drives.energy.turnover, 1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"faults__dead_motor": ["front"]},
        {"faults__stuck_wheel": ["x"]},
        {"faults__frozen_encoder": [""]},
        {"mismatch__friction": [1.0, 1.0]},
        {"mismatch__radius": [1.0] * 5},
    ],
    ids=str,
)
def test_parameters_inconsistent_with_the_robot_are_rejected_and_change_nothing(changes):
    with pytest.raises(ParameterError):
        Rig(**changes)
    rig = Rig("omniman")
    rig.velocity(1.0, 3.0)
    before = rig.drives.parameters
    with pytest.raises(ParameterError):
        rig.drives.set_parameters(parameters(plant__lifted=True, **changes))
    assert rig.drives.parameters is before
    rig.velocity(0.1, 3.0)
    assert rig.drives.ground_truth()[1][0] > 0.3


def test_masses_can_change_in_motion_and_a_tipping_robot_is_rejected():
    rig = Rig("omniman")
    rig.velocity(1.0, 3.0)
    with pytest.raises(ParameterError):
        rig.drives.configure(
            robot("omniman", arm__mass=60.0), parameters(faults__dead_motor=["nobody"])
        )
    assert rig.drives._plant._mass == pytest.approx(160.4)
    rig.drives.configure(robot("omniman", arm__mass=60.0, arm__com_x=0.1), parameters())
    twist = rig.drives.ground_truth()[1]
    rig.velocity(0.5, 3.0)
    assert rig.drives.ground_truth()[1][0] == pytest.approx(twist[0], abs=0.02)
    with pytest.raises(ParameterError, match="must be above the wheels"):
        rig.drives.configure(robot("omniman", arm__mass=2000.0, arm__com_x=2.0), parameters())
    rig.velocity(0.1, 3.0)
    assert abs(rig.drives.energy.residual) < 1e-9 * rig.drives.energy.turnover


@pytest.mark.parametrize("name", representative(ROBOTS, every=3))
def test_energy_balances_with_the_firmware_loops(name):
    rig = Rig(name, faults__current_noise=0.05)
    rng = np.random.default_rng(2)
    for _ in range(8):
        rig.velocity(0.2, rng.uniform(-4, 4, rig.n))
        rig.torque(0.1, rng.uniform(-1, 1, rig.n))
        rig.voltage(0.1, rng.uniform(-10, 10, rig.n))
    rig.run(0.8)
    energy = rig.drives.energy
    assert energy.turnover > 1.0
    assert abs(energy.residual) <= 1e-3 * energy.turnover
    assert min(energy.losses.values()) >= 0.0
    assert rig.drives._plant.unsettled == 0
