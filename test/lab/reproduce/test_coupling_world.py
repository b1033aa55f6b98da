import argparse
import importlib.util
import json

import pytest

from omniman_ros.cli.arguments.lab import WORLD_WHEELS
from omniman_ros.cli.main import main
from omniman_ros.console.errors import CommandError
from omniman_ros.core.parameters import specs
from omniman_ros.lab.reproduce import command, coupling_world
from omniman_ros.lab.reproduce.coupling_world import STANDARD, aim, cases
from omniman_ros.lab.studies.coupling import LAG_CONTROLLER, OWN_CONTROLLER
from omniman_ros.simulation.world.parameters import WorldParameters
from test import robots

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")


def row(gain, error, energy, controller=LAG_CONTROLLER):
    return {
        "group": "PI",
        "controller": controller,
        "k": gain,
        "epsilon_ratio": {"mean": error if controller == OWN_CONTROLLER else 9.0},
        "error_ratio": {"mean": error if controller == LAG_CONTROLLER else 9.0},
        "energy_ratio": {"mean": energy},
    }


def options(**given):
    values = {"name": "coupling", "robot": "omniman", "quick": True, "full": False, "seed": 0}
    return argparse.Namespace(**values, **{"world": "rollers", **given})


def test_each_set_of_wheels_is_driven_without_control_with_it_and_with_the_lag():
    chosen = cases(STANDARD, robots.values("omniman"), 15.0, 0)
    same = [case for case in chosen if (case.group, case.sample) == ("torque", 3)]
    assert [(case.controller, case.gain) for case in same] == [
        (OWN_CONTROLLER, 0.0),
        (OWN_CONTROLLER, 5.0),
        (OWN_CONTROLLER, 15.0),
        (LAG_CONTROLLER, 5.0),
        (LAG_CONTROLLER, 15.0),
    ]
    assert len({case.mismatch for case in same}) == 1


@pytest.mark.parametrize("form", [OWN_CONTROLLER, LAG_CONTROLLER])
def test_a_form_is_judged_at_the_gain_that_leaves_least_within_the_energy(form):
    (other,) = {OWN_CONTROLLER, LAG_CONTROLLER} - {form}
    rows = [row(0.0, 1.0, 1.0, OWN_CONTROLLER), row(15.0, 0.01, 0.5, other)]
    dear = [row(5.0, 0.3, 1.02, form), row(15.0, 0.1, 1.1, form)]
    reached = aim([*rows, row(8.0, 0.2, 1.005, form), row(9.0, 0.3, 1.0, form), *dear], "PI", form)
    assert (reached["k"], reached["error_met"], reached["energy_met"]) == (8.0, True, True)
    reached = aim([*rows, *dear], "PI", form)
    assert (reached["k"], reached["error_met"], reached["energy_met"]) == (5.0, False, False)


def test_the_kinds_of_wheels_on_the_command_line_are_those_of_the_world():
    (wheels,) = (spec for spec in specs(WorldParameters) if spec.name == "wheels")
    assert set(WORLD_WHEELS) == set(wheels.choices)


def test_experiments_that_have_no_world_refuse_it(capsys):
    assert main(["reproduce", "free_paper", "--world"]) == 2
    assert "--world is an option of coupling" in capsys.readouterr().err


def test_without_the_engine_the_world_is_refused_with_the_way_to_get_it(monkeypatch):
    monkeypatch.setattr(type(command.WORLD), "is_available", property(lambda extra: False))
    with pytest.raises(CommandError, match="mujoco-core"):
        command.run(options())


@IN_WORLD
@pytest.mark.exhaustive
def test_on_rollers_the_lag_halves_what_the_motors_heat(tmp_path):
    assert coupling_world.run(options(results=str(tmp_path))) == 0
    result = json.loads((tmp_path / "reproduce_coupling_rollers.json").read_text())
    (with_lag,) = (each for each in result["aims"] if each["controller"] == LAG_CONTROLLER)
    assert with_lag["error_met"] and with_lag["energy_met"]
    without, with_lag = (
        next(r for r in result["table"] if r["k"] == 15.0 and r["controller"] == controller)
        for controller in (OWN_CONTROLLER, LAG_CONTROLLER)
    )
    assert with_lag["copper"]["mean"] < 0.5 * without["copper"]["mean"]
