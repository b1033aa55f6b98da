"""Agreement of the package's files: facts that are written twice, and names of what exists."""

import ast
import configparser
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import setuptools
import yaml
from catkin_pkg.package import parse_package

from omniman_ros.cli.commands import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(ROOT.glob("omniman_ros/**/*.py"))

# Module and rosdep key of each Python distribution.
DISTRIBUTIONS = {
    "argcomplete": ("argcomplete", "python3-argcomplete"),
    "numpy": ("numpy", "python3-numpy"),
    "PyYAML": ("yaml", "python3-yaml"),
    "python-can": ("can", "python3-can"),
    "canopen": ("canopen", "canopen-pip"),
    "msgpack": ("msgpack", "python3-msgpack"),
    "casadi": ("casadi", "casadi-pip"),
    "lark-parser": ("lark", "python3-lark-parser"),
    "scipy": ("scipy", "python3-scipy"),
    "distributed": ("distributed", None),
    "mujoco-core": ("mujoco", None),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "pillow": ("PIL", "python3-pil"),
    "rosbags": ("rosbags", "python3-rosbags-pip"),
    "viser": ("viser", None),
    "websockets": ("websockets", "python3-websockets"),
}
#: Packages that a peer in a benchmark imports in a process and from a folder of its own
OWN_FOLDER = {"acados"}
# Packages of a ROS machine that are not available as wheels.
ROS_MACHINE_ONLY = {
    "control_msgs",
    "launch",
    "launch_ros",
    "map_msgs",
    "nav2_msgs",
    "ros2cli",
    "tf2_msgs",
}


@pytest.fixture
def setup_py(monkeypatch):
    """Return the globals of setup.py, and under "arguments" those of its call of `setup`."""
    arguments = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", lambda **given: arguments.update(given))
    return runpy.run_path("setup.py") | {"arguments": arguments}


@pytest.fixture
def package_xml():
    return parse_package(str(ROOT))


def imports(statements):
    """Return the top-level modules that statements import, without this package and Python's."""
    names = set()
    for node in statements:
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.partition(".")[0])
    return names - sys.stdlib_module_names - {"omniman_ros"}


def test_package_xml_and_setup_py_describe_the_same_package(package_xml, setup_py):
    arguments = setup_py["arguments"]
    assert package_xml.name == arguments["name"]
    assert package_xml.version == arguments["version"]
    assert package_xml.description == arguments["description"]
    assert package_xml.licenses == [arguments["license"]]
    (maintainer,) = package_xml.maintainers
    assert maintainer.name == arguments["maintainer"]
    assert maintainer.email == arguments["maintainer_email"]


def test_colcon_sees_an_ament_python_package(package_xml):
    assert package_xml.package_format == 3
    assert package_xml.get_build_type() == "ament_python"


def test_the_changelog_has_the_version(setup_py):
    assert re.search(
        rf"^## .*\b{re.escape(setup_py['arguments']['version'])}\b",
        (ROOT / "CHANGELOG.md").read_text(),
        re.MULTILINE,
    )


def test_a_citation_has_the_version_of_the_package(package_xml):
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == package_xml.version
    assert citation["license"] == package_xml.licenses[0]


def test_a_bug_report_asks_for_commands_that_exist():
    report = yaml.safe_load((ROOT / ".github/ISSUE_TEMPLATE/bug_report.yml").read_text())
    text = " ".join(str(part["attributes"]) for part in report["body"])
    named = set(re.findall(r"\bomniman ([a-z]+)", text))
    assert {"info", "status", "record"} == named <= set(COMMANDS)


def test_required_distributions_are_in_package_xml(package_xml, setup_py):
    keys = {depend.name for depend in package_xml.exec_depends}
    for distribution in setup_py["arguments"]["install_requires"]:
        _, key = DISTRIBUTIONS[distribution]
        assert key is None or key in keys


def test_the_documentation_names_the_keys_of_rosdep_and_what_ubuntu_needs_for_them(package_xml):
    keys = {depend.name for depend in package_xml.exec_depends if depend.name.endswith("-pip")}
    assert keys == {"canopen-pip", "casadi-pip", "python3-rosbags-pip"}
    text = (ROOT / "docs" / "ros.md").read_text()
    assert all(f"`{key}`" in text for key in keys)
    assert "PIP_BREAK_SYSTEM_PACKAGES=1 rosdep install" in text


def test_the_wheels_of_rclpy_are_not_required(setup_py):
    assert not [name for name in setup_py["arguments"]["install_requires"] if "ros" in name]


def test_every_import_is_a_declared_dependency(package_xml, setup_py):
    declared = {depend.name for depend in package_xml.exec_depends}
    extras = setup_py["arguments"]["extras_require"]
    named = ("record", "plot", "viewer", "world", "cluster")
    optional = [distribution for name in named for distribution in extras[name]]
    for distribution in [*setup_py["arguments"]["install_requires"], *optional]:
        declared.add(DISTRIBUTIONS[distribution.partition("==")[0]][0])
    for source in [*SOURCES, *ROOT.glob("config/launch/*.py")]:
        found = imports(ast.walk(ast.parse(source.read_text())))
        undeclared = found - declared - OWN_FOLDER
        assert not undeclared, f"{source.relative_to(ROOT)} imports {undeclared}"


def test_packages_of_ros_machines_only_are_imported_at_run_time():
    for source in SOURCES:
        at_start = imports(ast.parse(source.read_text()).body) & ROS_MACHINE_ONLY
        assert not at_start, f"{source.relative_to(ROOT)} needs {at_start} at its import"


def test_every_executable_has_an_existing_function(setup_py):
    assert setup_py["EXECUTABLES"]
    for target in setup_py["EXECUTABLES"].values():
        module, function = target.split(":")
        source = ROOT.joinpath(*module.split(".")).with_suffix(".py")
        defined = ast.parse(source.read_text()).body
        assert function in [node.name for node in defined if isinstance(node, ast.FunctionDef)]


def test_every_package_folder_is_installed(setup_py):
    folders = {".".join(source.relative_to(ROOT).parent.parts) for source in SOURCES}
    assert folders == set(setup_py["arguments"]["packages"])


def test_every_shared_file_is_installed_once(setup_py):
    installed = [
        file
        for folder, files in setup_py["arguments"]["data_files"]
        if folder.startswith("share/omniman_ros/")
        for file in files
    ]
    shared = [path for path in ROOT.glob("config/**/*") if path.is_file()]
    shared = [path for path in shared if "__pycache__" not in path.parts]
    assert sorted(installed) == sorted(str(path.relative_to(ROOT)) for path in shared)


def test_the_marker_of_the_ament_index_is_installed(setup_py):
    files = dict(setup_py["arguments"]["data_files"])
    assert files["share/ament_index/resource_index/packages"] == ["resource/omniman_ros"]
    assert (ROOT / "resource" / "omniman_ros").is_file()
    assert files["share/omniman_ros"] == ["package.xml"]


def test_colcon_installs_executables_where_ros2_run_searches():
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    assert config["develop"]["script_dir"] == "$base/lib/omniman_ros"
    assert config["install"]["install_scripts"] == "$base/lib/omniman_ros"


def test_a_stub_runs_the_executable_of_its_own_prefix(tmp_path, setup_py):
    (tmp_path / "bin").mkdir()
    (tmp_path / "lib" / "omniman_ros").mkdir(parents=True)
    real = tmp_path / "bin" / "omniman"
    real.write_text('#!/bin/sh\necho "$0" "$@"\nexit 3\n')
    stub = tmp_path / "lib" / "omniman_ros" / "omniman"
    stub.write_text(setup_py["STUB"].format(name="omniman"))
    for script in (real, stub):
        script.chmod(0o755)
    linked = tmp_path / "linked"
    linked.symlink_to(stub)
    for script in (stub, linked):
        ended = subprocess.run([script, "a b", "c"], cwd="/", capture_output=True, text=True)
        started, arguments = ended.stdout.rstrip().split(" ", 1)
        assert Path(started).resolve() == real
        assert arguments == "a b c"
        assert ended.returncode == 3


def named_in_readme(command):
    """Return the words that follow a command in the code of the README."""
    readme = (ROOT / "README.md").read_text()
    code = re.findall(r"```.*?```|`[^`]+`", readme, re.DOTALL)
    return set(re.findall(rf"\b{command} ([\w.-]+)", "\n".join(code)))


def test_every_make_command_of_the_readme_is_a_target():
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    assert {"demo", "test"} <= named_in_readme("make") <= targets


def test_every_ros2_command_of_the_readme_names_an_installed_file(setup_py):
    assert named_in_readme("ros2 run omniman_ros") <= set(setup_py["EXECUTABLES"])
    launch_files = {file.name for file in ROOT.glob("config/launch/*")}
    assert named_in_readme("ros2 launch omniman_ros") <= launch_files


def test_every_makefile_target_is_phony_and_explained():
    makefile = (ROOT / "Makefile").read_text()
    phony = set(re.search(r"^\.PHONY: (.*)", makefile, re.MULTILINE)[1].split())
    assert phony == set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    assert phony == set(re.findall(r"^([a-z-]+):.*## ", makefile, re.MULTILINE))


@pytest.mark.parametrize(
    ("python", "message"),
    [
        ("exit 127", "does not run"),
        ('case "$2" in *exit*) exit 1;; esac; echo 3.10', "is Python 3.10"),
        ('case "$2" in *ensurepip*) exit 1;; esac; echo 3.12', "apt-get install python3.12-venv"),
    ],
    ids=["shim", "version", "ensurepip"],
)
def test_a_missing_prerequisite_is_named_with_the_command_that_installs_it(
    tmp_path, python, message
):
    interpreter = tmp_path / "python"
    interpreter.write_text(f"#!/bin/sh\n{python}\n")
    interpreter.chmod(0o755)
    ended = subprocess.run(
        [ROOT / ".ci" / "venv", tmp_path / "venv"],
        env=os.environ | {"PYTHON": str(interpreter)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 1
    assert message in ended.stderr
    assert "apt-get install" in ended.stderr
    assert not (tmp_path / "venv").exists()
