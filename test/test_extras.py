"""What to install for an optional feature, and how the machine accepts it."""

import sys
import sysconfig

import pytest

from omniman_ros import extras
from omniman_ros.extras import PLANNING


@pytest.mark.parametrize(
    ("is_managed", "is_system", "command"),
    [
        (True, True, "pip install --break-system-packages casadi"),
        (True, False, "pip install casadi"),
        (False, True, "pip install casadi"),
    ],
)
def test_the_hint_is_a_command_that_this_interpreter_accepts(
    monkeypatch, tmp_path, is_managed, is_system, command
):
    if is_managed:
        (tmp_path / "EXTERNALLY-MANAGED").touch()
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    monkeypatch.setattr(sys, "base_prefix", sys.prefix if is_system else "/usr")
    assert extras.PLANNING.hint == f"the planner needs casadi: {command}"


def test_a_feature_is_available_if_all_its_modules_are(monkeypatch):
    assert PLANNING.is_available
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert not PLANNING.is_available
