"""Tests of what the page shows of scanners, tracker and world, and of the shapes for it."""

import math

import numpy as np
import pytest

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.robots import robot_parameters
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.viewer.body_view import BodyShapes, obstacles_around
from omniman_ros.viewer.map_image import FREE, MOST_PIXELS, OCCUPIED, map_image, map_pixels
from omniman_ros.viewer.perceived import (
    ARROW_TIME,
    DEVIATIONS,
    FRESHNESS_TIMEOUT,
    Contact,
    Perceived,
    Tracks,
    uncertainty_circles,
    velocity_arrows,
)
from omniman_ros.viewer.placed_obstacles import ObstacleArrays

TRACKS = Tracks(
    np.array([[1.0, 2.0], [5.0, 0.0]]),
    np.array([[0.3, -0.4], [0.0, 0.0]]),
    np.array([0.2, 0.3]),
    np.array([0.05, 0.1]),
    np.array([0.1, 0.0]),
)
LATE = FRESHNESS_TIMEOUT + 0.01


def test_an_arrow_leads_to_where_a_tracked_obstacle_will_be():
    arrows = velocity_arrows(TRACKS)
    assert arrows.shape == (3, 2, 2), "one shaft and two sides of its head; who stands has none"
    assert arrows[0] == pytest.approx(np.array([[1.0, 2.0], [1.3, 1.6]]) * ARROW_TIME)
    assert (arrows[:, 1] == arrows[0, 1]).all()


def test_circles_have_the_size_of_the_uncertainty():
    circles = uncertainty_circles(TRACKS)
    ends = np.concatenate((circles[:, 0], circles[:, 1]))
    around = np.hypot(*(ends - (5.0, 0.0)).T)
    assert np.isclose(around, 0.3 + DEVIATIONS * 0.1).sum() == 48
    at_tip = np.hypot(*(ends - (1.3, 1.6)).T)
    assert np.isclose(at_tip, DEVIATIONS * 0.1 * ARROW_TIME).sum() == 48


def test_what_is_out_of_date_is_not_drawn():
    perceived = Perceived()
    perceived.update_scan("front", np.ones((2, 3)), 10.0)
    perceived.update_scan("rear", np.zeros((3, 3)), 10.5)
    perceived.update_tracks(TRACKS, 10.0)
    perceived.update_margin(0.2, 10.0)
    perceived.update_speed_fractions((0.5, 1.0), 10.0)
    perceived.contacts["a"] = Contact("a touches b", np.zeros(3), 1.0, 10.0)
    perceived.sample(10.9)
    assert len(perceived.scan.points) == 5 and len(perceived.tracks) == 2
    assert perceived.tip_over_margin == 0.2 and perceived.contacts
    perceived.sample(10.0 + LATE)
    assert len(perceived.scan.points) == 3 and len(perceived.tracks) == 0
    assert (perceived.tip_over_margin, perceived.speed_fractions) == (None, None)
    assert not perceived.contacts
    perceived.sample(5.0)
    assert len(perceived.scan.points) == 0, "time went back"


def test_a_map_shows_what_is_free_occupied_and_unknown():
    pixels, count = map_pixels(np.array([[0, 100, -1], [50, 0, 0]], dtype=np.int8))
    assert count == 1
    assert tuple(pixels[0, 0]) == FREE and tuple(pixels[0, 1]) == OCCUPIED
    assert pixels[0, 2, 3] == 0
    assert OCCUPIED[0] < pixels[1, 0, 0] < FREE[0]


def test_a_large_map_keeps_its_thin_walls():
    cells = np.zeros((10, 2 * MOST_PIXELS + 1), dtype=np.int8)
    cells[:, 301] = 100
    pixels, count = map_pixels(cells)
    assert count == 3 and pixels.shape[:2] == (4, math.ceil(cells.shape[1] / 3))
    assert (pixels[:3, 100] == OCCUPIED).all() and (pixels[:3, 101] == FREE).all()


def test_a_map_lies_where_its_corner_says():
    image = map_image(np.zeros((10, 40, 4), np.uint8), 0.1, np.array([1.0, 2.0, math.pi / 2]))
    assert image.size == pytest.approx((4.0, 1.0))
    assert image.middle == pytest.approx((1.0 - 0.5, 2.0 + 2.0, math.pi / 2))


@pytest.fixture(scope="module")
def shapes():
    description = build(DescriptionParameters, robot_parameters("omniman"))
    return BodyShapes(description, ToolShape(), LoadShape())


ARM = np.array([0.0, -1.2, 1.6, -0.4, 1.2, 0.0])


def near(*points):
    scan = np.array(points).reshape(-1, 3)
    return obstacles_around(np.zeros(3), Ellipses.none(), ObstacleArrays.empty(), scan)


def test_the_nearest_thing_is_found_with_the_part_and_the_distance(shapes):
    pose = np.array([1.0, 0.0, math.pi / 2])
    view = shapes.view(pose, ARM, near((1.0, 3.0, 0.2), (1.0, -2.0, 0.2), (-1.5, 0.0, 0.2)))
    assert view.nearest is not None
    tip = view.footprint[..., 1].max()
    length = robot_parameters("omniman")["body.length"]
    assert view.nearest.distance == pytest.approx(2.0 - 0.5 * length)
    assert view.nearest.part == "platform", "the arm is in front, the point behind"
    assert view.nearest.line[1, :2] == pytest.approx((1.0, -2.0))
    gap = np.linalg.norm(view.nearest.line[1] - view.nearest.line[0])
    assert gap == pytest.approx(view.nearest.distance, abs=0.01)
    assert tip > 0.5, "the footprint is turned with the robot, and has the arm in it"
    ahead = shapes.view(pose, ARM, near((1.0, 1.2, 0.2))).nearest
    assert ahead is not None and ahead.part.startswith("wrist")


def moving_disc(x, y, vx, vy):
    return Ellipses.circles(0.0, [[x, y]], [[vx, vy]], 0.2)


def test_a_plan_is_shown_by_platform_and_arm_at_each_instant_and_by_what_it_avoids(shapes):
    plan = np.zeros((2, 9))
    plan[:, 3:], plan[1, :3] = ARM, (1.0, 2.0, math.pi / 2)
    way = [
        obstacles_around(
            q[:3], moving_disc(3.0, 2.0, -1.0, 0.0), ObstacleArrays.empty(), np.zeros((0, 3)), t
        )
        for q, t in zip(plan, (0.0, 1.0), strict=True)
    ]
    view = shapes.plan_view(plan, way)
    assert len(view.ghosts) == 4 + 6, "edges of the platform, and links of the arm"
    box = robot_parameters("omniman")
    x, y, z = np.moveaxis(view.ghosts[:4].reshape(-1, 3), 1, 0)
    assert (x.mean(), y.mean()) == pytest.approx((1.0, 2.0))
    sizes = box["body.width"], box["body.length"]
    assert (np.ptp(x), np.ptp(y), np.ptp(z)) == pytest.approx((*sizes, 0.0)), "it is turned"
    mount = (1.0, 2.0 + box["mount.x"], box["mount.z"])
    assert view.ghosts[4, 0] == pytest.approx(mount)
    assert view.nearest is not None
    gap = 1.0 - 0.5 * box["body.width"] - 0.2
    assert view.nearest.distance == pytest.approx(gap, abs=1e-6)
    begin, end = view.nearest.line
    assert end[:2] == pytest.approx([1.8, 2.0]), "the surface of what is there by then"
    assert math.dist(begin, end) == pytest.approx(gap, abs=1e-6)
    assert shapes.plan_view(plan, [near((50.0, 0.0, 0.2))] * 2).nearest is None


def test_ghosts_are_apart_from_the_robot_and_from_each_other(shapes):
    plan = np.zeros((9, 9))
    plan[:, 3:], plan[:, 0] = ARM, (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75)
    nothing = near(*np.zeros((0, 3)))
    ghosts = shapes.plan_view(plan, [nothing] * 9).ghosts.reshape(-1, 10, 2, 3)
    places = ghosts[:, :4, :, 0].mean(axis=(1, 2))
    assert places == pytest.approx((0.75, 0.5, 0.3)), "the end, and what leads there"
    turning = np.zeros((3, 9))
    turning[:, 3:], turning[:, 3] = ARM, (0.0, 0.6, 1.2)
    assert len(shapes.plan_view(turning, [nothing] * 3).ghosts) == 2 * 10, "the arm counts, too"


def test_without_anything_near_there_is_no_nearest(shapes):
    assert shapes.view(np.zeros(3), ARM, near((50.0, 0.0, 0.2))).nearest is None
    assert shapes.view(np.zeros(3), ARM, near(*np.zeros((0, 3)))).nearest is None
