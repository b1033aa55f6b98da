"""Names in the package."""

import ast
from collections import defaultdict
from pathlib import Path

import omniman_ros

ROOT = Path(omniman_ros.__file__).parent


def test_every_public_class_has_a_name_of_its_own():
    places = defaultdict(list)
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT).as_posix())
    assert len(places) > 500
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
