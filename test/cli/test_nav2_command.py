"""Tests of `omniman nav2` and `omniman map`."""

import numpy as np
import pytest
import yaml

from omniman_ros.cli.main import main
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.occupancy import occupancy


def test_the_parameters_are_printed_or_written(capsys, tmp_path):
    assert main(["nav2", "--robot", "ig42", "--namespace", "robot1", "--keepout"]) == 0
    printed = yaml.safe_load(capsys.readouterr().out)["robot1"]
    assert printed["global_costmap"]["global_costmap"]["ros__parameters"]["filters"]
    file = tmp_path / "nav2.yaml"
    assert main(["nav2", "--output", str(file), "-p", "limits.linear_velocity:=0.5"]) == 0
    controller = yaml.safe_load(file.read_text())["controller_server"]["ros__parameters"]
    assert controller["FollowPath"]["vx_max"] == 0.4


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["nav2", "-p", "footprint.posture:=[0.0]"], 2, "footprint.posture"),
        (["nav2", "--params-file", "/nowhere.yaml"], 2, "no parameter file '/nowhere.yaml'"),
        (["nav2", "--output", "/proc/nowhere"], 1, "No such file or directory"),
        (["map", "nowhere"], 2, "nowhere"),
        (["map", "workshop", "--resolution", "0"], 2, "resolution"),
        (["map", "workshop", "--output", "/proc/nowhere"], 1, "No such file or directory"),
    ],
)
def test_what_prevents_a_file_is_reported_in_one_line(words, code, message, capsys):
    assert main(words) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert message in error


def test_a_map_of_a_scene_is_what_the_map_server_reads(tmp_path):
    stem = tmp_path / "maps" / "workshop"
    assert main(["map", "workshop", "--output", str(stem), "--resolution", "0.1"]) == 0
    about = yaml.safe_load(stem.with_suffix(".yaml").read_text())
    assert about["image"] == "workshop.pgm" and about["mode"] == "trinary"
    assert about["negate"] == 0 and about["resolution"] == 0.1
    kind, size, depth, rows = (stem.parent / about["image"]).read_bytes().split(b"\n", 3)
    assert (kind, depth) == (b"P5", b"255")
    columns, lines = map(int, size.split())
    # The picture's first row is the map's last; black is occupied.
    picture = np.frombuffer(rows, np.uint8).reshape(lines, columns)[::-1]
    grid = occupancy(load_scene("workshop"), 0.1)
    assert about["origin"] == [*grid.origin, 0.0]
    assert ((255 - picture) / 255 > about["occupied_thresh"]).tolist() == grid.occupied.tolist()
    assert ((255 - picture) / 255 < about["free_thresh"]).tolist() == (~grid.occupied).tolist()
