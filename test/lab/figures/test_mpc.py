from dataclasses import replace

import numpy as np
import pytest

from test import robots

pytest.importorskip("matplotlib")

from matplotlib.colors import to_rgba

from omniman_ros.core.parameters import build
from omniman_ros.lab.figures import mpc as mpc_picture
from omniman_ros.lab.figures import top_view
from omniman_ros.lab.figures.mpc import snapshot_times
from omniman_ros.lab.figures.top_view import TopView
from omniman_ros.lab.studies.mpc_cases import Scene, circle
from omniman_ros.lab.studies.mpc_loop import MotionRecord, Trace
from omniman_ros.lab.studies.planned_drives import PlannedDrive
from omniman_ros.lab.studies.recorded_drive import Drive, wall_gaps
from omniman_ros.lab.studies.scene_geometry import Wall
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.parameters import Arrival

ROBOT = robots.robot("ig42")
SINCE = 0.25
OBSTACLES = (
    circle(0.3, TwoVelocityPath((1.5, 0.9))),
    circle(0.2, TwoVelocityPath((1.0, -2.0), (0.0, 0.5), 1.0, (0.0, -0.5))),
)


def ride(obstacles=OBSTACLES, seconds=2.0):
    """Return a synthetic drive at one metre per second."""
    course, trace = MotionRecord(), Trace()
    for time in np.arange(SINCE, SINCE + seconds, 0.005).tolist():
        course.times.append(time)
        x = min(time - SINCE, 1.0)
        course.poses.append(np.array([x, 0.0, 0.1 * x]))
        course.odometry.append(np.array([x, 0.0, 0.0]))
        course.twists.append(np.array([float(x < 1.0), 0.0, 0.0]))
        course.energy.append(time)
    for time in np.arange(0.0, seconds, 0.05).tolist():
        ahead = SINCE + time + np.arange(-0.3, 1.01, 0.1)  # a motion keeps part of its past
        trace.times.append(time)
        trace.plan_times.append(ahead)
        trace.plans.append(np.column_stack([ahead - SINCE, 0 * ahead, 0 * ahead]))
        trace.states.append(PlannerState.DRIVING if time < 1.0 else PlannerState.ARRIVED)
        centers = np.array([o.place(time + SINCE) for o in obstacles]).reshape(-1, 2)
        m = len(obstacles)
        trace.known.append(
            Ellipses(
                time + SINCE,
                centers,
                np.tile([0.0, 0.5], (m, 1)),
                np.full((m, 2), 0.3),
                np.zeros(m),
                np.zeros(m),
            )
        )
    goal = (1.0, 0.0, 0.0)
    half = np.array([0.4, 0.25])
    drive = Drive.of(course, SINCE, goal, build(Arrival, {}), half, obstacles)
    return PlannedDrive(drive, trace, PlannerState.ARRIVED, SINCE)


def scene(obstacles=OBSTACLES, snapshots=()):
    return Scene("test", (1.0, 0.0, 0.0), obstacles=obstacles, snapshots=snapshots)


class Axes:
    """Axes that record the drawing calls."""

    def __init__(self):
        self.patches, self.lines, self.texts = [], [], []

    def add_patch(self, patch):
        self.patches.append(patch)

    def plot(self, x, y, *_, **options):
        self.lines.append((np.atleast_1d(x), np.atleast_1d(y), options))

    def text(self, *args, **_):
        self.texts.append(args)

    def of(self, colour):
        return [line for line in self.lines if line[2].get("color") == colour]


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_obstacles_are_drawn_at_their_true_positions_at_that_time():
    axes = Axes()
    TopView(ROBOT, scene(), ride()).draw(axes, 1.0)
    ellipses = [p for p in axes.patches if isinstance(p, top_view.Ellipse)]
    places = [p.center for p in ellipses if p.get_alpha() is None]
    assert places == [pytest.approx(tuple(o.place(1.0 + SINCE))) for o in OBSTACLES]
    assert [text[2] for text in axes.texts] == ["1", "2"]


def test_predicted_positions_are_those_of_the_planner_and_drawn_faintly():
    axes = Axes()
    TopView(ROBOT, scene(), ride()).draw(axes, 0.5)
    faint = [p for p in axes.patches if isinstance(p, top_view.Ellipse) and p.get_alpha()]
    now = OBSTACLES[0].place(0.5 + SINCE)
    assert faint[0].center == pytest.approx(tuple(now + [0.0, 0.25]))
    assert len(faint) == 4  # two obstacles, at 0.5 and 1 s


def test_plan_is_drawn_from_the_robot_to_its_planned_end():
    axes = Axes()
    TopView(ROBOT, scene(), ride()).draw(axes, 0.5)
    ((x, _, _),) = axes.of(top_view.PLAN_COLOUR)
    assert (x[0], x[-1]) == pytest.approx((0.5, 1.5))
    way = axes.of(top_view.INK)[0]
    assert way[0][-1] == pytest.approx(0.5)


def test_robot_that_has_arrived_has_no_plan():
    axes = Axes()
    TopView(ROBOT, scene(), ride()).draw(axes, 1.8)
    assert not axes.of(top_view.PLAN_COLOUR)


def test_start_goal_and_robot_have_their_colours_and_show_the_heading():
    axes = Axes()
    TopView(ROBOT, scene(), ride()).draw(axes, 1.0)
    boxes = [p for p in axes.patches if isinstance(p, top_view.Polygon)]
    for colour in (top_view.START_COLOUR, top_view.GOAL_COLOUR, top_view.ROBOT_COLOUR):
        edge = to_rgba(colour)
        assert any(p.get_edgecolor() == edge for p in boxes), colour
    outline = next(
        p.get_xy() for p in boxes if p.get_edgecolor() == to_rgba(top_view.ROBOT_COLOUR)
    )
    side = outline[0] - outline[3]
    assert np.arctan2(side[1], side[0]) == pytest.approx(0.1, abs=1e-3)


def test_drawing_stays_within_the_bounds():
    x_min, x_max, y_min, y_max = TopView(ROBOT, scene(), ride()).bounds([0.0, 1.0])
    assert x_min < -0.4
    assert x_max > 1.8
    assert y_min < -2.0 + 0.5 * SINCE - 0.2
    assert y_max > 1.2


def test_snapshot_times_are_given_by_the_scene_or_spread_over_the_drive():
    assert snapshot_times(scene(snapshots=(0.2, 1.4)), ride()) == [0.2, 1.4]
    times = snapshot_times(scene(), ride(), 5)
    assert len(times) == 5
    assert 0.0 < times[0] < times[-1] < ride().drive.arrival
    assert np.diff(times) == pytest.approx(np.diff(times)[0])


@pytest.mark.parametrize(
    ("obstacles", "count", "columns"), [(OBSTACLES, 2, 3), (OBSTACLES[:1], 3, 2)]
)
def test_snapshots_are_drawn(tmp_path, obstacles, count, columns):
    path = tmp_path / "new" / "case.png"
    mpc_picture.draw_case(ROBOT, scene(obstacles), ride(obstacles), path, count, columns)
    assert is_png(path)


@pytest.mark.parametrize("missing", [False, True])
def test_free_case_is_drawn_with_and_without_figures(tmp_path, missing):
    nan = float("nan")
    energy = {
        "distance_m": 1.0,
        "bearing_deg": 0.0,
        "energy_j": 30.0,
        "speed_only_j": 28.0,
        "all_limits_j": nan,
        "ratio": 30 / 28,
    }
    lost = dict.fromkeys(("energy_j", "speed_only_j", "all_limits_j", "ratio"), nan)
    rows = [energy, {**energy, **lost}] if missing else [energy]
    free = scene((), (0.5, 1.0, 7.0))
    mpc_picture.draw_free(ROBOT, free, ride(()), {"energy": rows}, tmp_path / "free.png")
    assert is_png(tmp_path / "free.png")


@pytest.mark.exhaustive
def test_film_lasts_one_second_longer_than_the_drive(tmp_path):
    from PIL import Image

    seen = ride()
    mpc_picture.animate(ROBOT, scene(), seen, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        shown = film.n_frames * film.info["duration"] / 1e3
    assert shown == pytest.approx(seen.drive.arrival + 1.0, abs=0.2)


def test_drive_through_a_building_is_drawn_within_its_walls(tmp_path):
    walls = (Wall(0.5, 2.0, 0.0, 4.0, 0.1), Wall(-2.0, 0.0, 1.57, 3.0, 0.1))
    building = replace(scene(()), walls=walls)
    driven = ride(())
    gaps = wall_gaps(driven.drive.poses, np.array([0.4, 0.25]), walls)
    driven = replace(driven, drive=replace(driven.drive, gaps=gaps[:, None]))
    low_x, high_x, low_y, high_y = TopView(ROBOT, building, driven).bounds([0.0])
    assert low_x < -2.0 and high_x > 2.5 and high_y > 2.05 and low_y < -1.5
    axes = Axes()
    TopView(ROBOT, building, driven).draw_trail(axes, 0.4)
    assert len(axes.patches) > 2 + 3 * 2
    path = tmp_path / "trail.png"
    mpc_picture.draw_trail(ROBOT, building, driven, path)
    assert path.read_bytes()[:4] == b"\x89PNG"
