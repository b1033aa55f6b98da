import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies import kinematic_comparison
from omniman_ros.lab.studies.kinematic_comparison import drive_straight
from omniman_ros.lab.studies.mpc_cases import Scene, circle, corridor, moving
from omniman_ros.lab.studies.mpc_loop import MotionRecord
from omniman_ros.lab.studies.planned_drives import drive_with_planner
from omniman_ros.lab.studies.recorded_drive import SETTLING_TIME, Drive, StudyError, true_gaps
from omniman_ros.lab.studies.roller_diagonals import (
    angle_from_diagonal,
    diagonal_figures,
    roller_diagonals,
    steady_power,
)
from omniman_ros.planning.cases import RADIUS, TwoVelocityPath
from omniman_ros.planning.parameters import Arrival
from test import robots

IG42 = robots.values("ig42")
ROBOT = robots.robot("ig42")
HALF = np.array([0.4, 0.25])
STILL = np.zeros(3)


def course(xs, period=0.005):
    """Return a drive along x with heading 0 that consumes 10 J per second."""
    result = MotionRecord()
    for k, x in enumerate(xs):
        result.times.append(k * period)
        result.poses.append(np.array([x, 0.0, 0.0]))
        result.odometry.append(np.array([x, 0.0, 0.0]))
        speed = (x - xs[k - 1]) / period if k else 0.0
        result.twists.append(np.array([speed, 0.0, 0.0]))
        result.energy.append(5.0 + 10.0 * k * period)
    return result


def driven(xs, obstacles=(), goal=(1.0, 0.0, 0.0), since=0.0):
    return Drive.of(course(xs), since, goal, build(Arrival, {}), HALF, obstacles)


def there_and_rest(seconds=1.0, rest=1.0):
    return np.concatenate(
        [np.linspace(0, 1, round(seconds / 0.005)), np.ones(round(rest / 0.005))]
    )


# ---- judgement of drives ------------------------------------------------------------------------


def test_gap_to_a_passed_circle_is_exact():
    drive = driven(there_and_rest(), [circle(0.3, TwoVelocityPath((0.5, 0.65)))])
    assert drive.clearance == pytest.approx(0.65 - 0.25 - 0.3)
    assert not drive.collided


@pytest.mark.parametrize(("x", "gap"), [(1.71, 0.01), (1.69, -0.01)])
def test_contact_at_the_end_of_the_path_is_found_to_the_centimetre(x, gap):
    drive = driven(there_and_rest(), [circle(0.3, TwoVelocityPath((x, 0.0)))])
    assert drive.clearance == pytest.approx(gap, abs=1e-6)
    assert drive.collided is (gap < 0.0)


def test_fast_circle_that_crosses_a_standing_robot_is_a_contact():
    crossing = circle(0.05, TwoVelocityPath((0.0, -5.0), (0.0, 8.0)))
    drive = driven(np.zeros(400), [crossing], goal=(0.0, 0.0, 0.0))
    assert drive.collided
    # No contact off its path: 0.35 m beside its centre, 0.1 m beyond the front of the box.
    missing = circle(0.05, TwoVelocityPath((0.55, -5.0), (0.0, 8.0)))
    assert driven(np.zeros(400), [missing]).clearance == pytest.approx(0.1, abs=1e-3)


def test_circle_within_the_box_and_a_box_within_a_circle_are_contacts():
    for radius in (0.05, 3.0):
        assert driven(np.zeros(4), [circle(radius, TwoVelocityPath((0.0, 0.0)))]).collided


def test_unknown_pose_is_a_contact():
    poses = np.array([[0.0, 0.0, 0.0], [math.nan, 0.0, 0.0]])
    gaps = true_gaps(np.zeros(2), poses, HALF, [circle(0.3, TwoVelocityPath((5.0, 0.0)))])
    assert replace(driven(np.zeros(2)), gaps=gaps).collided


@pytest.mark.parametrize("gap", [0.0, math.nan, -math.inf])
def test_gap_that_is_not_above_zero_is_a_contact(gap):
    gaps = np.array([[0.5], [gap]])
    assert replace(driven(np.zeros(2)), gaps=gaps).collided


def test_no_contact_without_obstacles():
    drive = driven(there_and_rest())
    assert drive.clearance == math.inf
    assert not drive.collided


def test_changed_velocity_applies_from_its_time_on():
    place = TwoVelocityPath((1.0, 2.0), (0.0, -1.0), 3.0, (0.5, 0.0))
    assert place(0.0) == pytest.approx([1.0, 2.0])
    assert place(3.0) == pytest.approx([1.0, -1.0])
    assert place(5.0) == pytest.approx([2.0, -1.0])
    assert TwoVelocityPath((1.0, 2.0))(1e6) == pytest.approx([1.0, 2.0])


def test_arrival_is_when_the_robot_first_rests_within_the_tolerance():
    drive = driven(there_and_rest(1.0))
    assert drive.arrival == pytest.approx(1.0, abs=0.006)


def test_robot_that_leaves_its_goal_again_has_not_arrived_before():
    xs = np.concatenate([there_and_rest(1.0, 1.0), np.full(100, 0.9), np.ones(100)])
    assert driven(xs).arrival > 2.4
    assert driven(np.append(xs, [0.9, 0.9])).arrival == math.inf


def test_robot_that_drives_through_its_goal_has_not_arrived():
    assert driven(np.linspace(0.0, 1.0, 200)).arrival == math.inf


def test_energy_counts_until_half_a_second_after_arrival():
    drive = driven(there_and_rest(1.0, 2.0))
    assert drive.energy_until_rest() == pytest.approx(10.0 * (drive.arrival + SETTLING_TIME))
    with pytest.raises(StudyError, match="until rest"):
        driven(there_and_rest(1.0, 0.3)).energy_until_rest()
    with pytest.raises(StudyError, match="inf"):
        driven(np.zeros(100)).energy_until_rest()


def test_time_before_the_goal_was_sent_does_not_count():
    drive = driven(there_and_rest(1.0, 1.0), since=0.5)
    assert drive.times[0] == pytest.approx(0.0)
    assert drive.energy[0] == 0.0
    assert drive.arrival == pytest.approx(0.5, abs=0.006)


# ---- the diagonal -------------------------------------------------------------------------------


def test_diagonals_of_mecanum_wheels_are_at_45_degrees():
    assert np.degrees(roller_diagonals(ROBOT)) == pytest.approx([-45.0, 45.0], abs=1e-3)
    off = angle_from_diagonal(np.radians([0.0, 45.0, 135.0, -50.0, 180.0]), ROBOT)
    assert np.degrees(off) == pytest.approx([45.0, 0.0, 0.0, 5.0, 45.0], abs=1e-3)


def test_travel_along_a_diagonal_is_recognised():
    ahead = driven(there_and_rest())
    assert diagonal_figures(ahead, ROBOT)["along_diagonal"] is False
    slanted = replace(ahead, twists=ahead.twists[:, [0, 0, 2]])
    figures = diagonal_figures(slanted, ROBOT)
    assert figures["along_diagonal"] is True
    assert figures["share"] == 1.0
    assert figures["nearest_rad"] == pytest.approx(0.0, abs=1e-6)


def test_along_a_diagonal_power_is_that_of_two_wheels_and_their_currents():
    """The other two wheels stand still, with neither friction nor current."""
    changes = {"friction.viscous": [0.0], "friction.roller": [0.0]}
    robot = robots.robot("ig42", changes)
    motor, friction = robot.motor, robot.friction
    emf = motor.gear_ratio * motor.torque_constant
    current = friction.coulomb[0] / (motor.gear_efficiency * emf)
    wheel = 0.5 * math.sqrt(2.0) / robot.wheels.radius[0]
    (power,) = steady_power(robot, 0.5, np.array([math.pi / 4]))
    assert power == pytest.approx(2 * (motor.resistance * current**2 + emf * wheel * current))
    (ahead,) = steady_power(robot, 0.5, np.array([0.0]))
    assert ahead == pytest.approx(
        4 * (motor.resistance * current**2 + emf * 0.5 / robot.wheels.radius[0] * current)
    )


# ---- drives -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short():
    """Return a drive of half a metre ahead by the planner."""
    ticks = iter(range(10**6))
    return drive_with_planner(
        IG42, Scene("free", (0.5, 0.0, 0.0)), timer=lambda: 1e-3 * next(ticks)
    )


def test_planner_arrives_and_its_figures_agree(short):
    figures = short.figures()
    assert figures["reached"]
    assert not figures["collided"]
    assert 1.0 < figures["time_s"] < 4.0
    assert figures["off_m"] < 0.03
    assert 0 < figures["plans_used"] <= figures["cycles"]
    assert figures["cpu_median_ms"] == pytest.approx(2.0)  # the timer was read twice per cycle
    assert 10.0 < figures["energy_j"] < 100.0


@pytest.mark.exhaustive
def test_impassable_scene_ends_without_reaching_the_goal():
    wall = tuple(circle(0.5, TwoVelocityPath((1.5, y))) for y in (-1.8, -0.9, 0.0, 0.9, 1.8))
    ride = drive_with_planner(IG42, Scene("wall", (3.0, 0.0, 0.0), obstacles=wall, time_limit=6.0))
    figures = ride.figures()
    assert not figures["reached"]
    assert math.isnan(figures["energy_j"])
    assert math.isinf(figures["time_s"])


def test_gaps_of_the_corridor_are_wider_than_the_robot_and_shorter():
    places = np.array([o.place(0.0) for o in corridor().obstacles])
    gaps = np.hypot(*np.diff(places, axis=0).T) - 2 * RADIUS
    assert (gaps > 2 * HALF[1] + 0.1).all()
    assert (gaps < 2 * HALF[0]).all()


def test_one_of_the_moving_obstacles_changes_its_velocity_and_only_the_third():
    turned = [
        not np.allclose(np.diff([o.place(t) for t in (0.0, 10.0, 20.0)], 2, axis=0), 0.0)
        for o in moving().obstacles
    ]
    assert turned == [False, False, True, False]
    sides = [np.sign(o.place(0.0)[1]) for o in moving().obstacles]
    assert sides == [1, -1, 1, -1]


# ---- equal arrival times ------------------------------------------------------------------------


@pytest.mark.exhaustive
def test_kinematic_controller_arrives_at_the_requested_time():
    start, goal = (0.0, 0.0, 0.0), (0.3, 0.0, 0.0)
    fast = drive_straight(IG42, start, goal, 0.8).drive
    wanted = fast.arrival + 0.3
    found = kinematic_comparison.drive_straight_in_time(IG42, start, goal, wanted)
    assert found.drive.arrival == pytest.approx(
        wanted, abs=kinematic_comparison.ARRIVAL_TIME_TOLERANCE
    )
    assert found.speed < 0.8
    assert found.drive.energy_until_rest() < fast.energy_until_rest()


@pytest.fixture
def rides(monkeypatch):
    """Replace kinematic drives by ones whose arrival is a function of the limit scale."""
    asked = []

    def stand_in(law):
        def ride(robot, start, goal, speed, share=1.0, wheels=None):
            used = share * speed / 0.9
            asked.append(used)
            until = law(used)
            xs = np.append(there_and_rest(max(until, 0.01), 1.0), np.ones(200))
            return kinematic_comparison.KinematicDrive(driven(xs), speed, share)

        monkeypatch.setattr(kinematic_comparison, "drive_straight", ride)
        return asked

    return stand_in


@pytest.mark.parametrize("wanted", [2.05, 3.0, 7.0, 11.0])
@pytest.mark.parametrize("whole", [False, True])
def test_any_arrival_time_is_found(rides, wanted, whole):
    asked = rides(lambda share: 1.0 + 1.0 / share**0.8)
    found = kinematic_comparison.drive_straight_in_time(IG42, STILL, STILL, wanted, whole)
    assert found.drive.arrival == pytest.approx(
        wanted, abs=kinematic_comparison.ARRIVAL_TIME_TOLERANCE
    )
    assert len(asked) <= 8


def test_no_drive_is_found_for_an_impossible_arrival_time(rides):
    rides(lambda share: 2.0 / share)
    assert kinematic_comparison.drive_straight_in_time(IG42, STILL, STILL, 1.5) is None


def test_unequal_arrival_times_are_refused(rides):
    rides(lambda share: 2.0 if share > 0.5 else 4.0)
    with pytest.raises(StudyError, match="does not arrive at 3"):
        kinematic_comparison.drive_straight_in_time(IG42, STILL, STILL, 3.0)
