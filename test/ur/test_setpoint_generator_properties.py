"""Random walks over streamer and generator: sent setpoints obey the rules in any event."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.program_link import ProgramState
from omniman_ros.ur.streaming_messages import StreamingPhase
from omniman_ros.ur.streaming_supervisor import StreamingSupervisor

ARM = ArmParameters()
UPPER = np.array(ARM.each("upper"))
VELOCITY, ACCELERATION = ARM.velocity[0], ARM.acceleration[0]
ROUNDING = 1e-6  #: Resolution of a transmitted angle [rad]
LAGS = 5  #: Number of cycles by which the simulated arm lags its setpoints
SEEDS = range(12)
CYCLES = 500


class World:
    """A streamer, a controller with a lagging arm, and random requests and faults."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.parameters = self.sample = None
        self.blocking_reason = self.program_loss_reason = ""
        self.program = ProgramState.NONE
        self.address = ("10.0.0.2", 50001)
        self.now = 100.0 + self.random.random()
        self.runs = []  # the setpoints of each program
        self.read = 0
        self.stops_at = self.waits = None
        self.modes = {"robot_mode": 7, "safety_mode": 1}
        home = self.random.uniform(-0.4, 0.4, 6) * UPPER
        if self.random.random() < 0.5:  # one joint near its limit
            k = self.random.integers(6)
            home[k] = self.random.choice([-1, 1]) * (UPPER[k] - self.random.uniform(0.0, 0.2))
        self.places = [home] * (LAGS + 1)
        self.streamer = StreamingSupervisor(self, ARM, UrParameters(following_error=0.5))
        self.way = None
        self.refusals, self.reasons = [], set()
        self.hear()

    # ---- the link -----------------------------------------------------------------------------

    @property
    def connected(self):
        return not self.blocking_reason

    def start_program(self, text, now):
        self.program, self.waits = ProgramState.STARTING, self.random.integers(1, 12)

    def end_program(self):
        self.program = ProgramState.NONE

    def send(self, data):
        if self.program is not ProgramState.RUNNING:
            return False
        *numbers, mode = struct.unpack(">8i", data)
        place = np.array(numbers[1:]) * 1e-6
        if mode == 1:
            if not self.runs[-1]:
                assert place == pytest.approx(self.measured, abs=ROUNDING), (
                    "the first setpoint is the measured position"
                )
            assert not self.streamer_latched or self.streamer.phase is StreamingPhase.ENDING
            self.runs[-1].append(place)
            self.read += 1
        return True

    # ---- the controller -----------------------------------------------------------------------

    @property
    def measured(self):
        return self.places[0]

    @property
    def streamer_latched(self):
        return bool(self.streamer.stop_reason)

    def hear(self):
        velocity = (self.places[1] - self.places[0]) / PERIOD
        playing = self.program is ProgramState.RUNNING
        self.sample = ArmSample(
            self.now,
            self.now,
            tuple(self.measured),
            tuple(velocity),
            tuple(self.measured),
            (0.0,) * 6,
            **self.modes,
            runtime_state=2 if playing else 1,
            speed_scaling=1.0,
            read=self.read,
        )
        self.streamer.check([self.sample], self.now)

    def cycle(self):
        self.now += PERIOD
        if self.program is ProgramState.STARTING:
            self.waits -= 1
            if self.waits <= 0:
                self.program, self.read = ProgramState.RUNNING, 0
                self.runs.append([])
        self.streamer.tick(self.now, self.now + 0.0002)
        streams = self.program is ProgramState.RUNNING and self.runs[-1]
        self.places = [*self.places[1:], self.runs[-1][-1] if streams else self.places[-1]]
        if self.blocking_reason:
            self.streamer.check([], self.now)
        else:
            self.hear()
        self.refusals += self.streamer.take_refusals()
        self.reasons.add(self.streamer.stop_reason)

    # ---- requests and faults ------------------------------------------------------------------

    def new_way(self):
        """Start a random swing from the latest setpoint, sometimes beyond the limits."""
        rate = self.random.uniform(0.5, 4.0)
        peak = self.random.uniform(0.6, 1.1) * np.array([VELOCITY, ACCELERATION / rate]).min()
        sizes = self.random.uniform(-1.0, 1.0, 6) * peak / rate
        home, begin = self.places[-1], self.now

        def way(times):
            angle = np.maximum(rate * (times - begin), 0.0)[:, None]
            return (
                home + sizes * (1.0 - np.cos(angle)),
                sizes * rate * np.sin(angle),
                sizes * rate**2 * np.cos(angle),
            )

        self.way = way

    def act(self):
        """Apply one random event."""
        random, streamer = self.random, self.streamer
        if random.random() < 0.3 and self.way is not None:
            start = self.now + random.normal(-0.004, 0.002)
            times = start + np.arange(0.0, random.uniform(0.05, 0.5), random.choice([0.008, 0.02]))
            q, v, a = self.way(times)
            if random.random() < 0.05:
                q = q + random.choice([0.05, 0.16, 3.0, 2.0 * np.pi])
            streamer.follow(
                JointPreview(times, q, v, a if random.random() < 0.7 else None), self.now
            )
        dice = random.random()
        if dice < 0.012:
            self.new_way()
        elif dice < 0.014:
            streamer.hold(True)
        elif dice < 0.024:
            streamer.hold(False)
        elif dice < 0.025:
            streamer.stop("~/stop")
        elif dice < 0.027:
            self.modes["safety_mode"] = 3
        elif dice < 0.0285:
            self.blocking_reason = "no data for 0.08 s"
        elif dice < 0.030:
            self.program, self.program_loss_reason = ProgramState.LOST, "reset"
        elif dice < 0.070:
            self.modes["safety_mode"], self.blocking_reason = 1, ""
            streamer.reset(self.now)
        elif dice < 0.100 and streamer.phase is StreamingPhase.IDLE:
            streamer.start(self.now)
        elif dice < 0.101:
            streamer.finish()


def walk(seed, cycles=CYCLES):
    world = World(seed)
    world.streamer.start(world.now)
    for _ in range(cycles):
        world.act()
        world.cycle()
    return world


@pytest.fixture(scope="module")
def worlds():
    return [walk(seed) for seed in SEEDS]


def runs(worlds):
    result = [np.array(run) for world in worlds for run in world.runs if len(run) > 2]
    assert sum(map(len, result)) > 1000, "enough setpoints were sent for a meaningful test"
    assert max(np.abs(np.diff(run, axis=0)).max() for run in result) > PERIOD, "the arm moved"
    return result


def test_speeds_and_accelerations_always_stay_within_their_limits(worlds):
    for run in runs(worlds):
        speeds = np.diff(run, axis=0, prepend=run[:1]) / PERIOD
        rates = np.diff(speeds, axis=0, prepend=0 * speeds[:1]) / PERIOD
        assert np.abs(speeds).max() <= VELOCITY + 2.0 * ROUNDING / PERIOD
        assert np.abs(rates).max() <= ACCELERATION + 4.0 * ROUNDING / PERIOD**2


def test_positions_always_stay_within_their_limits(worlds):
    for run in runs(worlds):
        assert (np.abs(run) <= UPPER + 1e-4).all()


def test_every_stop_reason_occurred(worlds):
    text = " ".join(why for world in worlds for why in (*world.refusals, *world.reasons))
    for word in ("away", "holds", "~/stop", "protective stop", "no data", "acceleration"):
        assert word in text


@pytest.mark.parametrize("last", ["silence", "stop", "hold", "finish"])
def test_arm_always_comes_to_rest_and_stays_at_rest(last):
    for seed in SEEDS:
        world = walk(seed, 150)
        if world.streamer.phase is not StreamingPhase.STREAMING:
            continue
        if last == "stop":
            world.streamer.stop("~/stop")
        elif last == "hold":
            world.streamer.hold(True)
        elif last == "finish":
            world.streamer.finish()
        for _ in range(170):  # 0.5 s of preview, pi rad/s within 4.5 rad/s^2, plus a margin
            world.cycle()
        rest = world.places[-1]
        assert world.streamer.at_rest
        for _ in range(20):
            world.cycle()
            assert (world.places[-1] == rest).all()


def test_stopped_streamer_sends_no_setpoints_until_a_reset():
    for seed in SEEDS:
        world = walk(seed, 120)
        world.streamer.stop("~/stop")
        for _ in range(170):
            world.cycle()
        assert world.streamer.phase is StreamingPhase.IDLE
        count = sum(map(len, world.runs))
        for _ in range(30):
            world.new_way()
            times = world.now + np.arange(0.0, 0.2, 0.02)
            world.streamer.follow(JointPreview(times, *world.way(times)), world.now)
            world.streamer.hold(bool(world.random.integers(2)))
            world.cycle()
        assert sum(map(len, world.runs)) == count


def test_lower_limits_in_motion_never_increase_the_speed():
    for seed in SEEDS:
        world = walk(seed, 100)
        if world.streamer.phase is not StreamingPhase.STREAMING:
            continue
        world.streamer.configure(replace(ARM, velocity=(0.2,)), UrParameters(following_error=0.5))
        speeds = []
        for _ in range(150):
            before = world.places[-1]
            world.cycle()
            speeds.append(float(np.abs(world.places[-1] - before).max()) / PERIOD)
        fastest = np.array(speeds)
        assert (np.diff(fastest) <= 2.0 * ROUNDING / PERIOD).all() or fastest.max() <= 0.2 * 1.001
        assert fastest[-1] == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_preview_that_ends_in_motion_near_a_limit_stops_before_the_limit(seed):
    world = World(seed)
    speed = world.random.uniform(0.2, 1.0, 6) * 3.0 * world.random.choice([-1, 1], 6)
    k = world.random.integers(6)
    times = np.arange(0.0, 1.26, 0.025)
    u = np.minimum(times / 1.2, 1.0)
    way = 1.2 * (u**3 - 0.5 * u**4) + np.maximum(times - 1.2, 0.0)
    home = -0.5 * speed * way[-1]
    stop = speed[k] ** 2 / (2.0 * ACCELERATION) + 0.005
    home[k] = np.sign(speed[k]) * (UPPER[k] - stop) - speed[k] * way[-1]
    world.places = [home] * (LAGS + 1)
    world.hear()
    world.streamer.start(world.now)
    while world.streamer.phase is not StreamingPhase.STREAMING:
        world.cycle()
    rates = speed * (3.0 * u**2 - 2.0 * u**3)[:, None]
    preview = JointPreview(world.now + times, home + speed * way[:, None], rates)
    world.streamer.follow(preview, world.now)
    for _ in range(300):
        world.cycle()
    assert not any("stopped" not in refusal for refusal in world.refusals)
    assert world.streamer.at_rest
    assert (np.abs(np.array(world.runs[0])) <= UPPER + 1e-5).all()
