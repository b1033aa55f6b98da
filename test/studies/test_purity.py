import ast
from pathlib import Path

import pytest

import omniman_ros.studies

FILES = sorted(Path(omniman_ros.studies.__file__).parent.glob("**/*.py"))
ALLOWED = {"collections", "concurrent", "dataclasses", "functools", "math", "multiprocessing",
           "statistics", "typing", "numpy", "casadi"}  # fmt: skip


def imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)


def test_there_are_files_to_check():
    assert len(FILES) > 4


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_studies_import_core_planning_and_drive_only(path):
    for name in imports(path):
        if name.startswith("omniman_ros"):
            assert name.split(".")[1] in ("core", "drive", "planning", "studies"), name
        else:
            assert name.split(".")[0] in ALLOWED, name
