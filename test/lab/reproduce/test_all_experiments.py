"""`omniman reproduce all`: runs, reports and written files."""

import base64
import json
import os
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import pytest

from omniman_ros.cli.main import main, make_parser
from omniman_ros.extras import WORLD
from omniman_ros.lab.reproduce import provenance
from omniman_ros.lab.reproduce.experiments import EXPERIMENTS
from test.lab.reproduce.reproduced import EVERYTHING
from test.running import environment, is_alive

pytest.importorskip("jinja2", reason="jinja2 is not installed (extra 'plot')")
reproduce_all = pytest.importorskip("omniman_ros.lab.reproduce.all_experiments")

PNG = b"\x89PNG\r\n\x1a\n" + b"not really a picture"


class Launch:
    """Replaces the processes: writes results and records its arguments."""

    def __init__(self, folder, **codes):
        self.folder, self.codes = folder, codes
        self.asked = []

    @property
    def names(self):
        return [arguments[1] for arguments in self.asked]

    def __call__(self, arguments):
        self.asked.append(list(arguments))
        name = arguments[1]
        code = self.codes.get(name, 0)
        if code != "crashed":
            wheels = f"_{arguments[-1]}" if "--world" in arguments else ""
            self.write(name, wheels, passed=code == 0)
        return 1 if code == "crashed" else code

    def write(self, name, wheels="", **changes):
        picture = self.folder / f"reproduce_{name}{wheels}.png"
        picture.write_bytes(PNG)
        result = EVERYTHING[name] | {"picture": str(picture)} | changes
        (self.folder / f"reproduce_{name}{wheels}.json").write_text(json.dumps(result))


def arguments(folder, *more):
    return make_parser().parse_args(["reproduce", "all", "--results", str(folder), *more])


def run(folder, *more, **codes):
    launch = Launch(folder, **codes)
    code = reproduce_all.run(arguments(folder, *more), launch)
    result = json.loads((folder / "reproduce_all.json").read_text())
    return code, result, (folder / "report.html").read_text(encoding="utf-8"), launch


def verdicts(result):
    return {row["name"]: row["verdict"] for row in result["experiments"]}


def compared(result, quantity):
    return next(row for row in result["comparisons"] if row["quantity"] == quantity)


# ---- experiments ------------------------------------------------------------------------------


def test_every_experiment_is_run_once_and_a_page_and_json_are_written(tmp_path, capsys):
    code, result, page, launch = run(tmp_path)
    assert code == 0
    assert launch.names == list(EXPERIMENTS)
    assert result["passed"] is True
    assert set(verdicts(result).values()) == {"passed"}
    assert [row["drives"] for row in result["experiments"]] == [18, 1, 2, 3, 3, 3, 3, 2, 3, 8]
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert all(f"<b>{name}</b>" in page for name in EXPERIMENTS)


def test_command_line_runs_all_experiments(tmp_path, monkeypatch):
    launch = Launch(tmp_path)
    monkeypatch.setattr(reproduce_all, "run_subprocess", launch)
    assert main(["reproduce", "all", "--quick", "--results", str(tmp_path)]) == 0
    assert len(launch.asked) == len(EXPERIMENTS)
    assert all("--quick" in asked for asked in launch.asked)


def test_options_are_passed_on_and_scene_options_to_scenes_only(tmp_path):
    chosen = arguments(
        tmp_path,
        "--full",
        "--seed",
        "3",
        "--robot",
        "ig42",
        "--count",
        "5",
        "--solve-time",
        "0.01",
    )
    free = make_parser().parse_args(reproduce_all.experiment_arguments(chosen, "free"))
    assert vars(free) == vars(chosen) | {"name": "free", "count": None, "solve_time": None}
    scenes = make_parser().parse_args(reproduce_all.experiment_arguments(chosen, "scenes"))
    assert (scenes.count, scenes.solve_time, scenes.seeds) == (5, 0.01, None)


def test_with_world_what_can_is_driven_there_as_well_and_stands_beside_the_plants_figures(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(type(WORLD), "is_available", True)
    in_world = [name for name, experiment in EXPERIMENTS.items() if experiment.in_world]
    code, result, page, launch = run(tmp_path, "--world", corridor=0)
    assert code == 0
    assert launch.names == [*EXPERIMENTS, *in_world]
    assert all(asked[-2:] == ["--world", "rollers"] for asked in launch.asked[len(EXPERIMENTS) :])
    row = compared(result, "Three cases, defaults")
    assert row["in_world"] == row["measured"]
    assert "coupling on rollers" in result["also"]
    assert "In the physics world, wheels: rollers" in page


def test_without_results_from_the_world_the_page_has_no_column_for_it(tmp_path):
    _, result, page, _ = run(tmp_path)
    assert result["world"] is None
    assert "physics world" not in page


def test_failed_experiment_is_reported_and_the_others_run(tmp_path, capsys):
    code, result, page, launch = run(tmp_path, corridor=1)
    assert code == 1
    assert launch.names == list(EXPERIMENTS)
    assert verdicts(result)["corridor"] == "failed"
    assert verdicts(result)["moving"] == "passed"
    assert "Failed or without a result: corridor." in page
    assert "failed: corridor" in capsys.readouterr().out


def test_exit_code_of_1_is_a_failure_whatever_the_result(tmp_path):
    launch = Launch(tmp_path)

    def both(arguments):
        return launch(arguments) or int(arguments[1] == "tool_path")

    assert reproduce_all.run(arguments(tmp_path), both) == 1
    result = json.loads((tmp_path / "reproduce_all.json").read_text())
    assert verdicts(result)["tool_path"] == "failed"


def test_older_result_is_not_used_for_a_crashed_run(tmp_path):
    Launch(tmp_path).write("coupling")
    code, result, page, _ = run(tmp_path, coupling="crashed")
    assert code == 1
    assert verdicts(result)["coupling"] == "no result"
    row = compared(result, "Wheel slip")
    assert (row["verdict"], row["measured"]) == ("not measured", "no result of coupling")
    assert "<p>no picture</p>" in page


def test_reuse_runs_only_experiments_without_a_result(tmp_path):
    for name in ("coupling", "scenes"):
        Launch(tmp_path).write(name)
    code, result, page, launch = run(tmp_path, "--reuse")
    assert code == 0
    assert launch.names == [name for name in EXPERIMENTS if name not in ("coupling", "scenes")]
    reused = [row["name"] for row in result["experiments"] if row["reused"]]
    assert reused == ["coupling", "scenes"]
    assert "From earlier runs, see their dates: coupling, scenes." in page


def test_reused_result_that_failed_still_fails(tmp_path):
    Launch(tmp_path).write("moving", passed=False)
    code, result, _, _ = run(tmp_path, "--reuse")
    assert code == 1
    assert verdicts(result)["moving"] == "failed"


@pytest.mark.parametrize("content", ["", "[]", "{"])
def test_experiment_with_an_unreadable_result_is_run_again(tmp_path, content):
    (tmp_path / "reproduce_free.json").write_text(content)
    _, _, _, launch = run(tmp_path, "--reuse")
    assert "free" in launch.names


def test_missed_aim_is_reported_without_failure(tmp_path, monkeypatch):
    missed = EVERYTHING["coupling"] | {"aim": {"met": False}}
    monkeypatch.setitem(EVERYTHING, "coupling", missed)
    code, result, page, _ = run(tmp_path)
    assert code == 0
    assert verdicts(result)["coupling"] == "aim missed"
    assert "Failed" not in page


def test_folder_that_cannot_be_created_is_an_error_before_any_run(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["reproduce", "all", "--results", str(tmp_path / "file" / "in")]) == 1
    assert "--results" in capsys.readouterr().err


def test_reuse_is_an_option_of_all_only(tmp_path, capsys):
    assert main(["reproduce", "free", "--reuse", "--results", str(tmp_path)]) == 2
    assert "--reuse" in capsys.readouterr().err


# ---- processes ----------------------------------------------------------------------------------


def test_output_of_an_experiment_is_passed_on_without_its_json(monkeypatch, capsys):
    program = """print('a line'); print('{"name": "reproduce_free"}'); raise SystemExit(3)"""
    monkeypatch.setattr(reproduce_all, "command", lambda _: [sys.executable, "-c", program])
    assert reproduce_all.run_subprocess([]) == 3
    assert capsys.readouterr().out == "a line\n"


def test_interruption_ends_the_running_experiment(monkeypatch):
    program = "import os, time\nprint(os.getpid(), flush=True)\ntime.sleep(600)"
    monkeypatch.setattr(reproduce_all, "command", lambda _: [sys.executable, "-u", "-c", program])
    started = []

    def interrupt(line):
        started.append(int(line))
        raise KeyboardInterrupt

    monkeypatch.setattr(reproduce_all, "say", interrupt)
    with pytest.raises(KeyboardInterrupt):
        reproduce_all.run_subprocess([])
    assert not is_alive(started[0])


@pytest.mark.exhaustive
@pytest.mark.processes
def test_real_experiments_provide_every_figure_of_the_page(tmp_path, monkeypatch):
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    fabricated = Launch(tmp_path)
    real = {"coupling", "corridor"}

    def launch(arguments):
        return (reproduce_all.run_subprocess if arguments[1] in real else fabricated)(arguments)

    assert reproduce_all.run(arguments(tmp_path, "--quick"), launch) == 0
    result = json.loads((tmp_path / "reproduce_all.json").read_text())
    missing = {
        row["quantity"]
        for row in result["comparisons"]
        if real.issuperset(row["from"]) and row["verdict"] == "not measured"
    }
    assert missing == {
        "Coupling error at k = 2 as printed, PI loops"
    }  # a quick run has no PI loops
    assert compared(result, "Coupling error without control")["verdict"] == "agrees"
    printed, corrected = "Coupling error at k = 2 as printed, P loops", "J_a corrected"
    assert compared(result, printed)["verdict"] == "agrees"
    assert compared(result, f"Coupling error at k = 2, {corrected}")["verdict"] == "not alike"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Quick, a few drives only: coupling, corridor." in page


# ---- the page -----------------------------------------------------------------------------------


class Page(HTMLParser):
    """HTML parser that checks the nesting of tags and records loaded resources."""

    ALONE = ("meta", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.sources, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in self.ALONE:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_page_is_well_formed_and_loads_no_resources(tmp_path):
    _, _, text, _ = run(tmp_path)
    page = Page(text)
    assert page.open == []
    assert len(page.sources) == len(EXPERIMENTS)
    head = "data:image/png;base64,"
    assert all(base64.b64decode(source.removeprefix(head)) == PNG for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "http" not in text and "url(" not in text and "$" not in text


def test_text_of_results_is_escaped(tmp_path, monkeypatch):
    odd = EVERYTHING["free"] | {"robot": "<b>&robot.yaml"}
    monkeypatch.setitem(EVERYTHING, "free", odd)
    _, _, text, _ = run(tmp_path)
    assert "<b>&robot" not in text
    assert "<b>&robot.yaml" in Page(text).words


def test_quick_run_is_announced_at_the_top(tmp_path, monkeypatch):
    _, _, text, _ = run(tmp_path)
    assert "Quick" not in text
    monkeypatch.setitem(EVERYTHING, "free", EVERYTHING["free"] | {"quick": True})
    _, _, text, _ = run(tmp_path)
    assert "Quick, a few drives only: free." in text


def test_results_of_demo_and_benchmarks_are_included_if_present(tmp_path):
    _, without, text, _ = run(tmp_path)
    names = [row["quantity"] for row in without["own"]]
    assert names == ["Coupling control with late commands", "Random scenes"]
    assert "Also read" not in text
    for name in ("demo", "bench_mpc"):
        (tmp_path / f"{name}.json").write_text(json.dumps(EVERYTHING[name]))
    _, result, text, _ = run(tmp_path)
    own = {row["quantity"]: row["measured"] for row in result["own"]}
    assert "0.35 mm RMS" in own["Demo: tracking error of the platform"]
    assert "10.8 times" in own["Planner cycle, n = 20, four obstacles"]
    assert compared(result, "Setpoints of the arm, demo")["verdict"] == "agrees"
    assert "Also read, as they were found: demo (2026-01-02 03:04)" in text


def test_picture_is_read_from_the_folder_regardless_of_its_recorded_path(tmp_path):
    launch = Launch(tmp_path)
    for name in EXPERIMENTS:
        launch.write(name, picture=f"/elsewhere/reproduce_{name}.png")
    _, _, text, _ = run(tmp_path, "--reuse")
    assert len(Page(text).sources) == len(EXPERIMENTS)


def test_page_has_no_picture_without_matplotlib(tmp_path):
    launch = Launch(tmp_path)
    for name in EXPERIMENTS:
        launch.write(name, picture=None)
    _, _, text, _ = run(tmp_path, "--reuse")
    assert Page(text).sources == []
    assert text.count("no picture") == len(EXPERIMENTS)


# ---- versions -----------------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_commit_is_of_the_repository_that_tracks_the_package(tmp_path, monkeypatch):
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)

    def git(*words):
        subprocess.run(
            ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e", *words],
            check=True,
            capture_output=True,
        )

    tracked, other = tmp_path / "tracked.py", tmp_path / "other.py"
    tracked.write_text("1\n")
    other.write_text("1\n")
    assert provenance.commit(tracked) == ""
    git("init")
    git("add", "tracked.py")
    git("commit", "-m", "m", "--no-gpg-sign")
    clean = provenance.commit(tracked)
    assert len(clean) == 12
    assert provenance.commit(other) == ""
    tracked.write_text("2\n")
    assert provenance.commit(tracked) == clean + "+"


def test_versions_name_package_python_and_libraries():
    assert {"python", "omniman_ros", "numpy", "casadi"} <= set(provenance.versions())


def test_without_git_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "commit" not in provenance.versions()
