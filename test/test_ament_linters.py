"""The linters of ament, where they are installed: on ROS machines, with our settings."""

import shutil
from pathlib import Path

import pytest

pytestmark = pytest.mark.exhaustive

ROOT = Path(__file__).resolve().parents[1]
PLACES = [str(ROOT / place) for place in ("omniman_ros", "config/launch", "setup.py")]


def test_flake8():
    linter = pytest.importorskip("ament_flake8.main")
    code, errors = linter.main_with_errors(["--config", str(ROOT / "setup.cfg"), *PLACES])
    assert code == 0, "\n".join(errors)


def test_pep257():
    linter = pytest.importorskip("ament_pep257.main")
    # As for ruff: a class has the docstring of its __init__, and arguments may be described in
    # running text. D402 takes the shape in "Return positions (n, 2)." for a signature.
    arguments = ["--convention", "google", "--add-ignore", "D105", "D107", "D402", "D417"]
    assert linter.main([*PLACES, *arguments]) == 0


def test_xmllint():
    linter = pytest.importorskip("ament_xmllint.main")
    if shutil.which("xmllint") is None:
        pytest.skip("xmllint is not installed")
    assert not linter.main([str(ROOT / "package.xml")])
