"""The names that `import omniman_ros as om` gives."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import omniman_ros as om
from omniman_ros.extras import PLANNING, Extra


def run(code):
    """Return what a fresh interpreter prints as JSON."""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_the_package_alone_imports_nothing_but_the_standard_library():
    code = (
        "import sys; before = set(sys.modules); import json, omniman_ros; "
        "print(json.dumps(sorted({m.partition('.')[0] for m in set(sys.modules) - before}"
        " - sys.stdlib_module_names)))"
    )
    assert run(code) == ["omniman_ros"]


def test_every_name_is_imported_without_ros():
    code = (
        "import sys, json\n"
        "ros = ('rclpy', 'geometry_msgs', 'nav_msgs', 'std_msgs', 'std_srvs', 'diagnostic_msgs')\n"
        "sys.modules |= dict.fromkeys(ros)\n"
        "import omniman_ros as om\n"
        "print(json.dumps([n for n in om.__all__ if getattr(om, n).__name__ != n]))"
    )
    assert run(code) == []


def test_type_checkers_and_the_interpreter_see_the_same_names():
    tree = ast.parse(Path(om.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in ast.walk(block) if isinstance(node, ast.ImportFrom)]
    seen = {alias.asname: node.module for node in imports for alias in node.names}
    assert seen == {name: f"omniman_ros.{module}" for name, module in om._MODULES.items()}


def test_help_names_every_public_name():
    assert [name for name in om.__all__ if f"`{name}`" not in om.__doc__] == []
    assert len(om.__all__) <= 80


def test_every_public_name_is_on_a_page_of_the_documentation():
    folder = Path(om.__file__).parents[1] / "docs" / "python"
    text = "\n".join(page.read_text(encoding="utf-8") for page in folder.glob("*.md"))
    shown = set(re.findall(r"^\.\. auto\w+:: omniman_ros\.(\w+)$", text, re.MULTILINE))
    errors = {name for name in om.__all__ if name.endswith("Error")}
    assert shown == set(om.__all__) - errors
    assert [name for name in errors if f"`om.{name}`" not in text] == []


def test_every_public_name_says_what_it_is():
    assert [name for name in om.__all__ if not getattr(om, name).__doc__] == []


def test_when_a_library_is_missing_expect_the_rest_and_what_to_install(monkeypatch):
    monkeypatch.delitem(vars(om), "Planner", raising=False)
    monkeypatch.setattr(Extra, "is_available", property(lambda extra: extra is not PLANNING))
    assert {"Planner", "WholeBodyTask"} & set(dir(om)) == set()
    assert "World" in dir(om)
    with pytest.raises(ModuleNotFoundError, match=r"om\.Planner: .*pip install.* casadi"):
        _ = om.Planner


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Plannner'"):
        _ = om.Plannner
