"""Scenes from files."""

import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.share import share_path
from omniman_ros.simulation.scene_files import load_scene, scene_of
from omniman_ros.simulation.world.occupancy import occupancy
from omniman_ros.simulation.world.scene import Post

SHIPPED = sorted(file.stem for file in share_path("config", "worlds").glob("*.yaml"))


def test_the_promised_worlds_are_shipped():
    assert {"empty", "workshop", "corridor", "shop_floor", "clutter", "hall"} <= set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_robot_starts_in_the_open(name):
    """Nothing stands within 0.7 m: half the diagonal of a platform of 1.0 x 0.7 m is 0.61 m."""
    scene = load_scene(name)
    grid = occupancy(scene, 0.05)
    column, row = ((scene.start[:2] - grid.origin) / grid.resolution).astype(int)
    reach = 14
    around = grid.occupied[
        max(row - reach, 0) : row + reach, max(column - reach, 0) : column + reach
    ]
    assert not around.any()


def test_a_file_is_found_by_its_path(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("start: [1, 2, 0.5]\nposts:\n  - {name: post, x: 1, y: 2.5}\n")
    scene = load_scene(str(file))
    assert scene.start == (1, 2, 0.5)
    assert scene.posts == (Post(name="post", x=1.0, y=2.5),)


def test_an_empty_file_is_an_empty_floor(tmp_path):
    file = tmp_path / "nothing.yaml"
    file.write_text("")
    assert not list(load_scene(str(file)).elements())


def test_clutter_becomes_posts():
    field = {"name": "post", "x_min": 0, "x_max": 5, "y_min": -2, "y_max": 2}
    scene = scene_of({"clutter": [field], "posts": [{"name": "own", "x": 0, "y": 0}]}, "file")
    assert len(scene.posts) > 5
    assert scene.posts[0].name == "own"


@pytest.mark.parametrize("name", ["nowhere", "", "../omniman", "no/file.yaml"])
def test_an_unknown_world_is_refused(name):
    with pytest.raises(ParameterError) as refused:
        load_scene(name)
    assert "workshop" in str(refused.value) or "no such file" in str(refused.value)


@pytest.mark.parametrize("content", ["[1, 2", "# gr\xfcn", "{a: !!python/object:os.system {}}"])
def test_a_file_that_is_no_yaml_is_refused(tmp_path, content):
    file = tmp_path / "bad.yaml"
    file.write_text(content, encoding="latin-1")
    with pytest.raises(ParameterError):
        load_scene(str(file))


@pytest.mark.parametrize(
    ("tree", "told"),
    [
        ([], "mapping"),
        ({"wall": []}, "walls"),
        ({1: []}, "walls"),
        ({"walls": {"name": "wall"}}, "list"),
        ({"posts": [{"name": "post", "x": 1, "y": 2, "hight": 1}]}, "height"),
        ({"posts": [{"name": "post", "x": 1}]}, "y"),
        ({"posts": ["post"]}, "mapping"),
        ({"posts": [{"name": "post", "x": "a", "y": 2}]}, "float"),
        ({"posts": [{"name": "post", "x": [1], "y": 2}]}, "float"),
        ({"persons": [{"name": "anna", "x": 1, "y": 2}]}, "array"),
        ({"start": 1}, "heading"),
        ({"start": [1, 2, "x"]}, "expected float, got str"),
        ({"posts": [{"name": "a", "x": 1, "y": 2}, {"name": "a", "x": 2, "y": 2}]}, "two"),
    ],
)
def test_a_mistake_is_told(tree, told):
    with pytest.raises(ParameterError, match=told):
        scene_of(tree, "file.yaml")
