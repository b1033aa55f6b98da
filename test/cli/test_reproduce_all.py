"""`omniman reproduce all`: what is run, what is told, and what is written."""

import base64
import json
import os
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import pytest

from omniman_ros.cli import reproduce, reproduce_all, reproduce_report
from omniman_ros.cli.main import main, make_parser
from omniman_ros.cli.reproduce_all import EXPERIMENTS

from .reproduced import EVERYTHING
from .support import environment, is_alive

PNG = b"\x89PNG\r\n\x1a\n" + b"not really a picture"


class Launch:
    """Stands for the processes: writes results, notes what it was asked for."""

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
            self.write(name, passed=code == 0)
        return 1 if code == "crashed" else code

    def write(self, name, **changes):
        picture = self.folder / f"reproduce_{name}.png"
        picture.write_bytes(PNG)
        result = EVERYTHING[name] | {"picture": str(picture)} | changes
        (self.folder / f"reproduce_{name}.json").write_text(json.dumps(result))


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


# ---- what is run --------------------------------------------------------------------------------


def test_every_experiment_is_run_once_and_a_page_and_json_are_written(tmp_path, capsys):
    code, result, page, launch = run(tmp_path)
    assert code == 0
    assert tuple(launch.names) == EXPERIMENTS
    assert set(EXPERIMENTS) == set(reproduce.ROBOTS)
    assert result["passed"] is True
    assert set(verdicts(result).values()) == {"passed"}
    assert [row["drives"] for row in result["experiments"]] == [10, 2, 3, 3, 3, 3, 8]
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == result
    assert all(f"<b>{name}</b>" in page for name in EXPERIMENTS)


def test_the_command_line_leads_there(tmp_path, monkeypatch):
    launch = Launch(tmp_path)
    monkeypatch.setattr(reproduce_all, "in_process", launch)
    assert main(["reproduce", "all", "--quick", "--results", str(tmp_path)]) == 0
    assert len(launch.asked) == len(EXPERIMENTS)
    assert all("--quick" in asked for asked in launch.asked)


def test_options_are_handed_on_those_of_scenes_to_scenes_alone(tmp_path):
    chosen = arguments(tmp_path, "--full", "--seed", "3", "--robot", "ig42", "--count", "5",
                       "--solve-time", "0.01")  # fmt: skip
    free = make_parser().parse_args(reproduce_all.options(chosen, "free"))
    assert vars(free) == vars(chosen) | {"name": "free", "count": None, "solve_time": None}
    scenes = make_parser().parse_args(reproduce_all.options(chosen, "scenes"))
    assert (scenes.count, scenes.solve_time, scenes.seeds) == (5, 0.01, None)


def test_one_that_fails_ends_nothing_and_is_told(tmp_path, capsys):
    code, result, page, launch = run(tmp_path, corridor=1)
    assert code == 1
    assert tuple(launch.names) == EXPERIMENTS
    assert verdicts(result)["corridor"] == "failed"
    assert verdicts(result)["moving"] == "passed"
    assert "Failed or without a result: corridor." in page
    assert "failed: corridor" in capsys.readouterr().out


def test_the_exit_code_counts_whatever_the_result_says(tmp_path):
    launch = Launch(tmp_path)

    def both(arguments):
        return launch(arguments) or int(arguments[1] == "tool_path")

    assert reproduce_all.run(arguments(tmp_path), both) == 1
    result = json.loads((tmp_path / "reproduce_all.json").read_text())
    assert verdicts(result)["tool_path"] == "failed"


def test_a_result_from_before_is_not_taken_for_one_of_a_run_that_crashed(tmp_path):
    Launch(tmp_path).write("coupling")
    code, result, page, _ = run(tmp_path, coupling="crashed")
    assert code == 1
    assert verdicts(result)["coupling"] == "no result"
    row = compared(result, "Wheel slip")
    assert (row["verdict"], row["measured"]) == ("not measured", "no result of coupling")
    assert "<p>no picture</p>" in page


def test_reuse_runs_only_what_has_no_result(tmp_path):
    for name in ("coupling", "scenes"):
        Launch(tmp_path).write(name)
    code, result, page, launch = run(tmp_path, "--reuse")
    assert code == 0
    assert launch.names == [name for name in EXPERIMENTS if name not in ("coupling", "scenes")]
    reused = [row["name"] for row in result["experiments"] if row["reused"]]
    assert reused == ["coupling", "scenes"]
    assert "From earlier runs, see their dates: coupling, scenes." in page


def test_a_reused_result_that_failed_still_fails(tmp_path):
    Launch(tmp_path).write("moving", passed=False)
    code, result, _, _ = run(tmp_path, "--reuse")
    assert code == 1
    assert verdicts(result)["moving"] == "failed"


@pytest.mark.parametrize("content", ["", "[]", "{"])
def test_what_cannot_be_read_is_run_again(tmp_path, content):
    (tmp_path / "reproduce_free.json").write_text(content)
    _, _, _, launch = run(tmp_path, "--reuse")
    assert "free" in launch.names


def test_an_aim_that_is_missed_is_told_and_no_failure(tmp_path, monkeypatch):
    missed = EVERYTHING["coupling"] | {"aim": {"met": False}}
    monkeypatch.setitem(EVERYTHING, "coupling", missed)
    code, result, page, _ = run(tmp_path)
    assert code == 0
    assert verdicts(result)["coupling"] == "aim missed"
    assert "Failed" not in page


def test_a_folder_that_cannot_be_made_is_told_before_anything_is_run(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["reproduce", "all", "--results", str(tmp_path / "file" / "in")]) == 1
    assert "--results" in capsys.readouterr().err


def test_reuse_is_of_all_only(tmp_path, capsys):
    assert main(["reproduce", "free", "--reuse", "--results", str(tmp_path)]) == 2
    assert "--reuse" in capsys.readouterr().err


# ---- processes ----------------------------------------------------------------------------------


def test_what_an_experiment_prints_goes_on_but_for_its_json(monkeypatch, capsys):
    program = """print('a line'); print('{"name": "reproduce_free"}'); raise SystemExit(3)"""
    monkeypatch.setattr(reproduce_all, "command", lambda _: [sys.executable, "-c", program])
    assert reproduce_all.in_process([]) == 3
    assert capsys.readouterr().out == "a line\n"


def test_an_interruption_ends_the_experiment_too(monkeypatch):
    program = "import os, time\nprint(os.getpid(), flush=True)\ntime.sleep(600)"
    monkeypatch.setattr(reproduce_all, "command", lambda _: [sys.executable, "-u", "-c", program])
    started = []

    def interrupt(line):
        started.append(int(line))
        raise KeyboardInterrupt

    monkeypatch.setattr(reproduce_all, "say", interrupt)
    with pytest.raises(KeyboardInterrupt):
        reproduce_all.in_process([])
    assert not is_alive(started[0])


@pytest.mark.processes
def test_real_experiments_have_what_the_page_asks_for(tmp_path, monkeypatch):
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
    fabricated = Launch(tmp_path)
    real = {"coupling", "corridor"}

    def launch(arguments):
        return (reproduce_all.in_process if arguments[1] in real else fabricated)(arguments)

    assert reproduce_all.run(arguments(tmp_path, "--quick"), launch) == 0
    result = json.loads((tmp_path / "reproduce_all.json").read_text())
    missing = {
        row["quantity"]
        for row in result["comparisons"]
        if real.issuperset(row["from"]) and row["verdict"] == "not measured"
    }
    assert missing == {"The same, PI loops at k = 2"}  # a quick run has none
    assert compared(result, "Coupling error without control")["verdict"] == "agrees"
    assert compared(result, "Coupling error at k = 2, P loops")["verdict"] == "differs"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Quick, a few drives only: coupling, corridor." in page


# ---- the page -----------------------------------------------------------------------------------


class Page(HTMLParser):
    """Sees whether tags are closed in order, and what the page would load."""

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


def test_the_page_is_whole_and_loads_nothing(tmp_path):
    _, _, text, _ = run(tmp_path)
    page = Page(text)
    assert page.open == []
    assert len(page.sources) == len(EXPERIMENTS)
    head = "data:image/png;base64,"
    assert all(base64.b64decode(source.removeprefix(head)) == PNG for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "http" not in text and "url(" not in text and "$" not in text


def test_text_of_results_is_no_html(tmp_path, monkeypatch):
    odd = EVERYTHING["free"] | {"robot": "<b>&robot.yaml"}
    monkeypatch.setitem(EVERYTHING, "free", odd)
    _, _, text, _ = run(tmp_path)
    assert "<b>&robot" not in text
    assert "<b>&robot.yaml" in Page(text).words


def test_a_quick_run_is_told_at_the_top(tmp_path, monkeypatch):
    _, _, text, _ = run(tmp_path)
    assert "Quick" not in text
    monkeypatch.setitem(EVERYTHING, "free", EVERYTHING["free"] | {"quick": True})
    _, _, text, _ = run(tmp_path)
    assert "Quick, a few drives only: free." in text


def test_results_of_demo_and_benches_are_told_where_they_are(tmp_path):
    _, without, text, _ = run(tmp_path)
    assert [row["quantity"] for row in without["own"]] == ["Random scenes"]
    assert "Also read" not in text
    for name in ("demo", "bench_mpc"):
        (tmp_path / f"{name}.json").write_text(json.dumps(EVERYTHING[name]))
    _, result, text, _ = run(tmp_path)
    own = {row["quantity"]: row["measured"] for row in result["own"]}
    assert "0.35 mm RMS" in own["Demo: platform off its path"]
    assert "10.8 times" in own["Planner's cycle, n = 20, four obstacles"]
    assert compared(result, "Setpoints of the arm, demo")["verdict"] == "agrees"
    assert "Also read, as they were found: demo (2026-01-02 03:04)" in text


def test_a_picture_is_of_the_folder_wherever_it_was_drawn(tmp_path):
    launch = Launch(tmp_path)
    for name in EXPERIMENTS:
        launch.write(name, picture=f"/elsewhere/reproduce_{name}.png")
    _, _, text, _ = run(tmp_path, "--reuse")
    assert len(Page(text).sources) == len(EXPERIMENTS)


def test_no_matplotlib_no_picture(tmp_path):
    launch = Launch(tmp_path)
    for name in EXPERIMENTS:
        launch.write(name, picture=None)
    _, _, text, _ = run(tmp_path, "--reuse")
    assert Page(text).sources == []
    assert text.count("no picture") == len(EXPERIMENTS)


# ---- versions -----------------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_commit_is_that_of_the_tree_which_tracks_the_package(tmp_path, monkeypatch):
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)

    def git(*words):
        subprocess.run(["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e",
                        *words], check=True, capture_output=True)  # fmt: skip

    tracked, other = tmp_path / "tracked.py", tmp_path / "other.py"
    tracked.write_text("1\n")
    other.write_text("1\n")
    assert reproduce_report.commit(tracked) == ""
    git("init")
    git("add", "tracked.py")
    git("commit", "-m", "m", "--no-gpg-sign")
    clean = reproduce_report.commit(tracked)
    assert len(clean) == 12
    assert reproduce_report.commit(other) == ""
    tracked.write_text("2\n")
    assert reproduce_report.commit(tracked) == clean + "+"


def test_versions_name_package_python_and_libraries():
    assert {"python", "omniman_ros", "numpy", "casadi"} <= set(reproduce_report.versions())


def test_without_git_there_is_no_commit(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "commit" not in reproduce_report.versions()
