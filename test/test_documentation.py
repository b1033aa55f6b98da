"""README and pages against the code."""

import json
import re
import runpy
import sys
import tomllib
from pathlib import Path

import pytest
import setuptools

from omniman_ros.cli.main import COMMANDS, main
from omniman_ros.nodes.registry import NODES, known_names, node_specs
from test.config.documented import ROOT

DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = sorted({*DOCS.glob("*.md"), *DOCS.glob("*/*.md")} - {DOCS / "changelog.md"})
RESULTS = sorted((DOCS / "results").glob("*.json"))


@pytest.fixture
def extension(monkeypatch):
    """The Sphinx extension of the documentation, where Sphinx is installed."""
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    import omniman_docs

    yield omniman_docs
    sys.modules.pop("omniman_docs", None)


def commands_in(path):
    named = set(re.findall(r"`omniman (\w+)", path.read_text(encoding="utf-8")))
    return named - {"COMMAND"}


def test_every_command_is_in_the_tables_of_commands():
    assert commands_in(DOCS / "commands.md") == set(COMMANDS)


@pytest.mark.parametrize("path", [README, *PAGES], ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_names_no_command_that_does_not_exist(path):
    assert commands_in(path) <= set(COMMANDS)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(DOCS)))
def test_a_page_names_no_parameter_that_does_not_exist(path):
    known = known_names()
    groups = {name.partition(".")[0] for name in known if "." in name}
    named = re.findall(r"`(\w+)\.(\w+)(?::=[\w.]+)?`", path.read_text(encoding="utf-8"))
    assert {f"{group}.{name}" for group, name in named if group in groups} <= known


def test_every_python_package_that_is_installed_is_explained(monkeypatch):
    arguments = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(setuptools, "setup", lambda **given: arguments.update(given))
    runpy.run_path("setup.py")
    page = (DOCS / "dependencies.md").read_text(encoding="utf-8")
    extras = arguments["extras_require"].values()
    for requirement in [
        *arguments["install_requires"],
        *(name for names in extras for name in names),
    ]:
        name = re.match(r"[\w.-]+", requirement)[0]
        assert f"`{name}" in page, name


def test_the_readme_stays_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.parametrize("path", [README, ROOT / "CONTRIBUTING.md"], ids=lambda path: path.name)
def test_files_that_are_linked_exist(path):
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text(encoding="utf-8"))
    files = [link for link in links if "://" not in link]
    assert files
    for file in files:
        assert (ROOT / file).exists(), file


def test_every_node_has_a_page_with_its_parameters():
    pages = {path.stem for path in (DOCS / "nodes").glob("*.md")} - {"index"}
    assert pages == set(NODES)
    index = (DOCS / "nodes" / "index.md").read_text(encoding="utf-8")
    for node in NODES:
        page = (DOCS / "nodes" / f"{node}.md").read_text(encoding="utf-8")
        assert page.startswith(f"# {node}\n")
        assert f"```{{parameters}} {node}\n" in page
        assert f"[{node}]({node}.md)" in index


def test_the_drawing_of_the_rooms_is_the_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = contracts["tool"]["importlinter"]["contracts"][0]["layers"]
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    drawing = page.partition("in every `make test`:")[2].split("```")[1].splitlines()[1:]
    drawn = [set(re.match(r" +(\w+(?: \| \w+)*)", line)[1].split(" | ")) for line in drawing]
    assert drawn == [set(re.findall(r"omniman_ros\.(\w+)", layer)) for layer in layers]


def test_every_launch_argument_is_in_the_table():
    launch = (ROOT / "config" / "launch" / "platform.launch.py").read_text(encoding="utf-8")
    arguments = re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', launch)
    table = (DOCS / "ros.md").read_text(encoding="utf-8").partition("## Arguments")[2]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == arguments


def test_the_command_prints_the_parameters_of_every_node(capsys):
    assert main(["parameters"]) == 0
    printed = capsys.readouterr().out
    for node in NODES:
        assert f"### {node}'s own\n" in printed
        for spec in node_specs(node):
            assert f"`{spec.name}`" in printed or f"`{spec.name.partition('.')[0]}.*`" in printed


def test_every_file_of_results_is_shown_on_a_page():
    pages = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "results").glob("*.md"))
    shown = re.findall(r"```\{figures\} (\w+)", pages)
    assert sorted(shown) == [path.stem for path in RESULTS]


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_every_figure_says_how_to_repeat_it(path):
    result = json.loads(path.read_text(encoding="utf-8"))
    assert result["conditions"]
    columns = result["columns"]
    assert all(len(row) == len(columns) for row in result["rows"])
    commands = [result["command"]] if "command" in result else []
    commands += [row[columns.index("command")] for row in result["rows"] if "command" in columns]
    assert commands
    assert all(commands)
    for file in re.findall(r"pytest (test/[\w/.]+)", " ".join(commands)):
        assert (ROOT / file).exists(), file


def test_a_bar_in_a_cell_of_results_does_not_end_the_cell(extension):
    lines = extension.markdown_of({"columns": ["a", "b"], "rows": [["|x|", "1"]]})
    assert list(lines)[-1] == "| \\|x\\| | 1 |"


def test_a_row_of_results_with_too_few_cells_is_refused(extension):
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        list(extension.markdown_of({"columns": ["a", "b"], "rows": [["1"]]}))


def safe(extension, *lines):
    rewritten = list(lines)
    extension.make_docstrings_safe(None, "function", "name", None, None, rewritten)
    return rewritten


def test_an_indented_equation_of_a_docstring_is_shown_as_it_is(extension):
    assert safe(extension, "The law:", "    tau = J_ | x", "holds.") == [
        "The law:",
        "",
        "::",
        "",
        "    tau = J_ | x",
        "",
        "holds.",
    ]


def test_a_list_of_a_docstring_stays_a_list(extension):
    lines = ["* one,", "  wrapped", "* two"]
    assert safe(extension, "Both:", "", *lines) == ["Both:", "", *lines]


def test_markup_characters_in_running_text_are_escaped_but_not_in_code(extension):
    assert safe(extension, "The |x| of x_ and `y_ | z`.") == ["The \\|x\\| of x\\_ and `y_ | z`."]


def test_sections_of_a_docstring_are_left_to_napoleon(extension):
    lines = ["Do.", "", "Args:", "    x: Length [m]."]
    assert safe(extension, *lines) == lines


def test_pages_name_no_machine_paths():
    for path in [README, *PAGES, *Path(DOCS, "results").glob("*.json")]:
        assert not re.search(r"/(home|work|tmp|root)/", path.read_text(encoding="utf-8")), path
