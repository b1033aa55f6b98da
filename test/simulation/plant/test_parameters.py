import ast
from pathlib import Path

import pytest

import omniman_ros.simulation.plant
from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.plant.parameters import flags, per_wheel

MODULES = (
    "contact",
    "encoder",
    "energy_ledger",
    "drive_unit",
    "parameters",
    "plant",
    "simulated_drives",
    "wheel",
    "lossy_channel",
)
CONFIGURATION = {"arrays", "errors", "parameters", "platform", "validated"}


def test_arrays_have_one_value_or_one_per_wheel():
    assert per_wheel("a", (2.0,), 3) == (2.0, 2.0, 2.0)
    assert per_wheel("a", (1.0, 2.0, 3.0), 3) == (1.0, 2.0, 3.0)
    with pytest.raises(ParameterError, match="must have one value or 3, one per wheel"):
        per_wheel("a", (1.0, 2.0), 3)


def test_wheels_are_flagged_by_name():
    assert flags("a", ("y",), ("x", "y", "z")) == (False, True, False)
    assert flags("a", (), ("x", "y")) == (False, False)
    with pytest.raises(ParameterError, match="must be one of "):
        flags("a", ("w",), ("x", "y"))


@pytest.mark.parametrize("module", MODULES)
def test_plant_shares_no_model_with_the_controller(module):
    """The plant imports only configuration from the core."""
    path = Path(omniman_ros.simulation.plant.__file__).parent / f"{module}.py"
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "omniman_ros" and parts[1:3] != ["simulation", "plant"]:
                assert parts[1] == "core", name
                assert parts[2] in CONFIGURATION, name
            assert parts[0] not in ("rclpy", "time", "threading", "can"), name
