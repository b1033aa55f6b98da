"""The controller's side of an arm whose joints are in a world, with a link that the test holds."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.simulation.arm_link.frames import ArmState
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.safety_checks import SafetyChecks
from omniman_ros.simulation.ur.world_arm import LEAD, LOCKSTEP_SILENCE, SILENCE, WAIT, WorldArm

PLACE = (0.1, -1.2, 1.0, 0.0, 0.5, 0.0)
REST = (0.0,) * 6


class FakeLink:
    """A link whose other side is the test."""

    def __init__(self):
        self.is_open, self.failure = False, "nobody listens"
        self.can_open = True
        self.attempts = self.waits = 0
        self.sent, self.states = [], []
        self.on_wait = lambda: False

    def open(self):
        self.attempts += 1
        self.is_open = self.can_open
        return self.is_open

    def receive(self):
        if not self.is_open:
            return []
        states, self.states = self.states, []
        return states

    def send(self, setpoint):
        self.sent.append(setpoint)

    def wait(self, timeout):
        assert timeout == WAIT
        self.waits += 1
        return self.on_wait()

    def close(self, reason):
        self.is_open, self.failure = False, reason

    def answer(self, count=1, torques=REST):
        """Answer the oldest setpoints as joints that are where they shall be."""
        for setpoint in self.sent[:count]:
            self.states.append(
                ArmState(setpoint.sequence, setpoint.positions, setpoint.velocities, torques)
            )
        del self.sent[:count]


class Run:
    def __init__(self, is_lockstep=True, connect=True):
        self.link = FakeLink()
        self.parameters = UrArmParameters()
        self.arm = WorldArm(self.parameters, self.link, is_lockstep)
        self.time = 5.0
        if connect:
            self.link.states.append(ArmState(0, PLACE, REST, REST))
            self.cycle(follow=False)

    def cycle(self, follow=True, target=PLACE):
        self.arm.measure(self.time)
        if follow:
            self.arm.follow(np.array(target), CYCLE)
        self.time += CYCLE


def test_before_the_world_answers_there_is_no_arm_and_nothing_is_sent():
    run = Run(connect=False)
    run.cycle()
    assert not run.arm.is_connected and run.link.sent == []
    run.link.states.append(ArmState(0, PLACE, REST, REST))
    run.cycle(follow=False)
    assert run.arm.is_connected and run.arm.failure == ""
    np.testing.assert_array_equal(run.arm.q, PLACE)
    np.testing.assert_array_equal(run.arm.reference.q, PLACE)


def test_a_world_that_is_not_there_is_looked_for_ten_times_a_second():
    run = Run(connect=False)
    run.link.can_open = False
    for _ in range(125):
        run.cycle()
    assert 9 <= run.link.attempts <= 11
    assert run.arm.failure == "nobody listens"


def test_setpoints_are_numbered_and_due_two_cycles_later():
    run = Run()
    for _ in range(3):
        run.cycle()
        run.link.answer(0)
    assert [s.sequence for s in run.link.sent] == [1, 2]
    first, second = run.link.sent
    assert first.begins_anew and not second.begins_anew and not first.braked
    assert first.due == pytest.approx(5.0 + CYCLE + LEAD)
    assert second.due - first.due == pytest.approx(CYCLE)


def test_a_cycle_on_simulated_time_waits_for_the_state_at_its_own_instant():
    run = Run()
    run.cycle()
    run.cycle()
    assert run.link.waits == 0, "nothing is due yet"

    def arrive():
        run.link.answer()
        return True

    run.link.on_wait = arrive
    run.cycle()
    assert run.link.waits == 1 and len(run.link.sent) == 2


def test_a_cycle_on_simulated_time_takes_no_state_of_a_later_instant():
    """The world may be ahead of the controller by up to a cycle."""

    def places(answers_at_once):
        run, target, seen = Run(), np.array(PLACE), []
        for _ in range(20):
            target = target + 0.004
            run.cycle(target=target)
            seen.append(run.arm.q[0])
            if answers_at_once:
                run.link.answer(len(run.link.sent))
            elif len(run.link.sent) > 1:
                run.link.answer()
        assert run.link.waits == 0
        return seen

    assert places(answers_at_once=True) == places(answers_at_once=False)
    assert places(answers_at_once=True)[-1] > PLACE[0]


def test_a_world_on_simulated_time_that_never_answers_is_silent_after_a_patience():
    run = Run()
    for _ in range(3):
        run.cycle()
    assert run.link.waits == round(LOCKSTEP_SILENCE / WAIT)
    assert not run.arm.is_connected and "has been silent" in run.arm.failure


def test_closing_ends_a_wait():
    run = Run()
    run.cycle()
    run.cycle()

    def close():
        run.arm.close()
        return False

    run.link.on_wait = close
    run.cycle()
    assert run.link.waits == 1


def test_on_real_time_nothing_is_waited_for_and_silence_is_found():
    run = Run(is_lockstep=False)
    for _ in range(round(SILENCE / CYCLE) - 2):
        run.cycle()
    assert run.arm.is_connected and run.link.waits == 0
    for _ in range(4):
        run.cycle()
    assert not run.arm.is_connected and "has been silent for 2.0 s" in run.arm.failure


def test_after_a_loss_the_joints_begin_where_they_are_found():
    run = Run()
    run.cycle(target=(0.2, *PLACE[1:]))
    run.link.close("gone")
    run.link.can_open = False
    run.cycle()
    assert not run.arm.is_connected
    run.link.can_open, run.link.sent = True, []
    moved = (0.3, *PLACE[1:])
    run.link.states.append(ArmState(0, moved, REST, REST))
    for _ in range(15):
        if not run.link.sent:
            run.cycle(target=moved)
    assert run.arm.is_connected
    assert run.link.sent[0].begins_anew
    assert run.link.sent[0].positions == pytest.approx(moved)


def test_a_loss_is_seen_for_a_cycle_before_a_new_connection():
    """Else the controller would go on with a reference that the world has forgotten."""
    run = Run()
    run.cycle()
    run.link.close("the world does not read")  # by sending
    run.link.states.append(ArmState(0, PLACE, REST, REST))
    run.cycle()
    assert not run.arm.is_connected and run.arm.failure == "the world does not read"


def test_locked_joints_are_braked_where_they_are():
    run = Run()
    run.arm.lock()
    (sent,) = run.link.sent
    assert sent.braked and sent.positions == pytest.approx(PLACE) and sent.velocities == REST
    run.cycle()
    assert not run.link.sent[1].braked and run.link.sent[1].begins_anew


def test_setpoints_pass_the_middles_of_the_reference_s_steps_at_its_speeds():
    """So a constant acceleration of the reference is one of the joints, too."""
    run = Run()
    goal = np.array(PLACE) + [3.0, 0, 0, 0, 0, 0]
    sent = []
    for _ in range(8):
        run.cycle(target=goal)
        sent.append(run.link.sent[-1])
        run.link.answer(len(run.link.sent))
    speeds = np.array([s.velocities[0] for s in sent])
    places = np.array([s.positions[0] for s in sent])
    np.testing.assert_allclose(np.diff(speeds) / CYCLE, 40.0)
    np.testing.assert_allclose(np.diff(places), CYCLE * (speeds[1:] + speeds[:-1]) / 2)


def collide(torque, cycles):
    """Return the violation after so many cycles with an unexpected torque of a joint [N m]."""
    run = Run()
    checks = SafetyChecks(run.parameters)
    found = None
    for _ in range(cycles + 2):
        run.cycle()
        if len(run.link.sent) == 2:
            free = run.arm.dynamics.torque(np.array(PLACE), np.zeros(6), np.zeros(6))
            run.link.answer(torques=tuple((free + [0, torque, 0, 0, 0, 0]).tolist()))
        found = checks.violation(run.arm, np.array(PLACE))
    return found


def test_a_torque_that_no_motion_explains_is_a_collision_after_its_time():
    assert collide(39.0, 20) is None
    assert collide(41.0, 2) is None
    violation = collide(-41.0, 6)
    assert violation.reason.startswith("collision detected by joint 1: 41.0 N m")
    assert violation.is_hindered


def test_a_joint_that_is_held_up_gives_way_and_the_others_go_on():
    run = Run()
    run.arm.reference.place(np.array(PLACE), np.array([1.0, 1.0, -1.0, 1.0, 0.0, 0.0]))
    run.link.states.append(ArmState(0, (0.05, *PLACE[1:]), (0.0, -3.0, -0.9, 5.0, 2.0, 0.0), REST))
    run.arm.measure(run.time)
    run.arm.give_way()
    assert run.arm.reference.q[0] == 0.05
    assert run.arm.reference.qd.tolist() == [0.0, 0.0, -0.9, 1.0, 0.0, 0.0]


def test_a_joint_that_is_behind_by_the_delay_of_the_link_alone_does_not_deviate():
    run = Run()
    checks = SafetyChecks(replace(run.parameters, collision_torque=(1e3,) * 6))
    speed, target = 3.2, np.array(PLACE)
    run.arm.reference.place(target, np.full(6, speed))
    for _ in range(50):
        target = target + speed * CYCLE
        run.cycle(target=target)
        if len(run.link.sent) == 2:
            run.link.answer()
        assert checks.violation(run.arm, target) is None
    assert np.abs(target - run.arm.q).max() > 0.08
