import pytest

from omniman_ros.lab.bench.whole_body_obstacles import METHODS

pytest.importorskip("matplotlib")
pytest.importorskip("mujoco")

from matplotlib.image import imread

from omniman_ros.lab import body_figures


def test_outcomes_are_drawn_where_a_method_completes_nothing(tmp_path):
    found = {name: {"scenes": 4, "time_ratios": [1.1, 1.3]} for name in METHODS}
    found[METHODS[-1]] = {"scenes": 4, "time_ratios": []}
    path = tmp_path / "outcomes.png"
    body_figures.draw_outcomes({"one": found, "other": found}, {"one": 0.9}, path)
    assert imread(path).std() > 0.0
    assert body_figures.plt.get_fignums() == []
