"""Scenes, their solids, grids and clutter; nothing here needs the engine."""

import math
from collections import deque

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.world.clutter import Clutter, clutter_posts
from omniman_ros.simulation.world.occupancy import occupancy
from omniman_ros.simulation.world.scene import Column, Crate, Person, Post, Scene, Table, Wall
from omniman_ros.simulation.world.solids import table_solids, wall_solids


def at(grid, x, y):
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.resolution).astype(int)
    return bool(grid.occupied[row, column])


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Post(name="post", x=0.0, y=0.0, radius=-1.0), "radius"),
        (lambda: Post(name="post", x=math.nan, y=0.0), "x"),
        (lambda: Post(name="post", x="here", y=0.0), "x"),
        (lambda: Post(name="", x=0.0, y=0.0), "name"),
        (lambda: Crate(name="crate", x=0.0, y=0.0, mass=0.0), "mass"),
        (lambda: Wall(name="wall", x=(0.0,), y=(0.0,)), "Wall.x"),
        (lambda: Wall(name="wall", x=(0.0, 1.0), y=(0.0,)), "Wall.x"),
        (lambda: Wall(name="wall", x=(1.0, 1.0), y=(2.0, 2.0)), "Wall.x"),
        (lambda: Wall(name="wall", x=(0.0, 2.0), y=(0.0, 0.0), doors=(2.5,)), "Wall.doors"),
        (lambda: Table(name="table", x=0.0, y=0.0, height=0.1, thickness=0.2), "thickness"),
        (lambda: Person(name="anna", x=(), y=()), "Person.x"),
        (lambda: Person(name="anna", x=(0.0, 1.0), y=(0.0,)), "Person.x"),
        (lambda: Scene(start=(0.0, 0.0)), "start"),
        (lambda: Scene(start=(0.0, math.inf, 0.0)), "start"),
        (lambda: Scene(posts=(Post(name="a", x=0.0, y=0.0),) * 2), "name"),
    ],
)
def test_impossible_elements_are_refused(make, named):
    with pytest.raises(ParameterError) as refused:
        make()
    assert named in refused.value.name


def test_a_door_is_a_gap_of_its_width_in_the_wall():
    wall = Wall(name="wall", x=(0.0, 4.0), y=(0.0, 0.0), thickness=0.2, doors=(1.5,), door_width=1)
    left, right = sorted(wall_solids(wall), key=lambda box: box.centre[0])
    assert left.centre[0] + 0.5 * left.size[0] == pytest.approx(1.0)
    assert right.centre[0] - 0.5 * right.size[0] == pytest.approx(2.0)
    assert left.size[1:] == (0.2, 2.0)


def test_a_door_behind_a_corner_is_in_the_second_piece():
    wall = Wall(name="wall", x=(0.0, 3.0, 3.0), y=(0.0, 0.0, 4.0), doors=(5.0,), door_width=1.0)
    grid = occupancy(Scene(walls=(wall,)), 0.05)
    assert at(grid, 3.0, 1.4)
    assert not at(grid, 3.0, 2.0)
    assert at(grid, 3.0, 2.6)
    assert at(grid, 1.5, 0.0)


def test_a_table_stands_on_legs_below_its_top():
    table = Table(name="table", x=2.0, y=1.0, yaw=math.pi / 2, length=2.0, width=1.0, height=0.8)
    top, *legs = table_solids(table)
    assert top.centre[2] + 0.5 * top.size[2] == pytest.approx(0.8)
    corners = {(round(leg.centre[0], 6), round(leg.centre[1], 6)) for leg in legs}
    assert corners == {
        (2.0 + i * 0.475, round(1.0 + j * 0.975, 6)) for i in (1, -1) for j in (1, -1)
    }


def test_the_grid_has_what_stands_below_the_height():
    table = Table(name="table", x=2.0, y=1.0, length=2.0, width=1.0, height=0.8)
    crate = Crate(name="crate", x=-1.0, y=0.0)
    low, high = (occupancy(Scene(tables=(table,), crates=(crate,)), 0.02, h) for h in (0.5, 1.0))
    assert not at(low, 2.0, 1.0)
    assert at(low, 2.0 + 0.975, 1.0 - 0.475)
    assert at(high, 2.0, 1.0)
    assert not at(high, -0.9, 0.0)


def test_a_disc_occupies_the_cells_that_it_touches():
    post = Post(name="post", x=1.0, y=2.0, radius=0.5)
    grid = occupancy(Scene(posts=(post,)), 0.01)
    area = grid.occupied.sum() * 0.01**2
    assert area == pytest.approx(math.pi * 0.5**2, rel=0.03)
    assert area > math.pi * 0.5**2
    rows, columns = np.nonzero(grid.occupied)
    centre = grid.origin + 0.01 * (np.array([columns.mean(), rows.mean()]) + 0.5)
    np.testing.assert_allclose(centre, [1.0, 2.0], atol=0.005)


def test_a_column_occupies_its_turned_ellipse():
    column = Column(name="column", x=1.0, y=2.0, yaw=0.5 * math.pi, length=1.0, width=0.4)
    grid = occupancy(Scene(columns=(column,)), 0.01)
    area = grid.occupied.sum() * 0.01**2
    assert area == pytest.approx(math.pi * 0.5 * 0.2, rel=0.06)
    assert at(grid, 1.0, 2.49) and at(grid, 1.0, 1.51) and not at(grid, 1.22, 2.0)


def test_a_turned_wall_is_turned_in_the_grid():
    wall = Wall(name="wall", x=(0.0, 3.0), y=(0.0, 3.0), thickness=0.1)
    grid = occupancy(Scene(walls=(wall,)), 0.02)
    assert all(at(grid, s, s) for s in np.linspace(0.05, 2.95, 50))
    assert not any(at(grid, s + 0.15, s - 0.15) for s in np.linspace(0.2, 2.8, 50))


@pytest.mark.parametrize("resolution", [0.0, -0.1, 1e-5, math.nan])
def test_a_grid_of_no_or_too_many_cells_is_refused(resolution):
    scene = Scene(posts=(Post(name="post", x=50.0, y=50.0),))
    with pytest.raises(ParameterError, match="resolution"):
        occupancy(scene, resolution)


FIELD = {"name": "post", "x_min": 0.0, "x_max": 10.0, "y_min": -3.0, "y_max": 3.0, "fill": 0.2}


@pytest.mark.parametrize("seed", range(3))
def test_a_way_as_wide_as_the_passage_leads_through_clutter(seed):
    """Flood the grid, grown by just less than half the passage, from end to end."""
    posts = clutter_posts(Clutter(seed=seed, passage=0.8, **FIELD))
    assert len(posts) > 80
    places = np.array([[post.x, post.y] for post in posts])
    x, y = np.meshgrid(np.arange(0.0, 10.01, 0.05), np.arange(-2.6, 2.61, 0.05), indexing="ij")
    distance = np.hypot(x[..., None] - places[:, 0], y[..., None] - places[:, 1]).min(axis=-1)
    free = distance > 0.075 + 0.38
    queue = deque((0, j) for j in np.nonzero(free[0])[0])
    seen = set(queue)
    while queue:
        i, j = queue.popleft()
        for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            inside = 0 <= a < free.shape[0] and 0 <= b < free.shape[1]
            if inside and free[a, b] and (a, b) not in seen:
                seen.add((a, b))
                queue.append((a, b))
    assert max(i for i, _ in seen) == free.shape[0] - 1


def test_clutter_follows_its_seed():
    first, again, other = (clutter_posts(Clutter(seed=seed, **FIELD)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize("change", [{"x_max": -1.0}, {"passage": 7.0}, {"radius": 5.0}])
def test_an_impossible_field_is_refused(change):
    with pytest.raises(ParameterError):
        Clutter(**{**FIELD, **change})


def test_cells_with_five_neighbours_fill_and_lonely_ones_vanish():
    field = {"name": "post", "x_min": 0.0, "x_max": 3.0, "y_min": 0.0, "y_max": 3.0}
    raw, smooth = (
        {(post.x, post.y) for post in clutter_posts(Clutter(smoothing=n, passage=0.0, **field))}
        for n in (0, 1)
    )

    def neighbours(x, y):
        around = [(x + 0.15 * i, y + 0.15 * j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
        return sum(any(math.dist(a, b) < 0.01 for b in raw) for a in around)

    assert {len(raw), len(smooth)} != {0}
    assert all((place in smooth) == (neighbours(*place) >= 2) for place in raw)
    assert all(neighbours(*place) >= 5 for place in smooth - raw)


def test_clutter_without_a_passage_is_refused(monkeypatch):
    monkeypatch.setattr("omniman_ros.simulation.world.clutter.MAX_DRAWS", 5)
    with pytest.raises(ParameterError, match="no passage"):
        clutter_posts(Clutter(**{**FIELD, "x_max": 0.6, "y_max": -2.0, "fill": 0.9}))
