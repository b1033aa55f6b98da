import io
import json
import math

import pytest

from omniman_ros.console import results
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import paint, say, table


def test_a_result_is_written_to_a_file_and_as_the_last_line(tmp_path, capsys):
    path = results.publish("demo", {"error_mm": 1.23456789, "ok": True}, tmp_path / "results")
    assert path == tmp_path / "results" / "demo.json"
    written = json.loads(path.read_text())
    assert written == json.loads(capsys.readouterr().out.splitlines()[-1])
    assert written["name"] == "demo"
    assert written["error_mm"] == 1.235
    assert written["ok"] is True
    assert written["about"]["python"]
    assert [file.name for file in path.parent.iterdir()] == ["demo.json"]


def test_numbers_that_are_not_finite_become_null():
    value = {"a": [math.nan, 1.0], "b": (math.inf, 12345.678), "c": "text", "d": 7}
    assert results.rounded(value) == {"a": [None, 1.0], "b": [None, 12350.0], "c": "text", "d": 7}


def test_a_folder_that_cannot_be_created_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        results.publish("demo", {}, tmp_path / "file")


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return Terminal()


def test_progress_is_one_line_for_each_part_without_a_terminal():
    stream = io.StringIO()
    progress = Progress(stream)
    progress.begin("forward")
    for i in range(100):
        progress.update(i / 100, "x 0.1")
    progress.end("x 0.75")
    text = stream.getvalue()
    assert text.count("\n") == 1
    assert "forward" in text and "x 0.75" in text
    assert "\r" not in text and "\033" not in text


def test_progress_without_a_terminal_is_a_line_now_and_then(monkeypatch):
    stream = io.StringIO()
    times = iter([0.0, 0.0, 4.9, 5.0, 6.0, 10.1])
    monkeypatch.setattr("omniman_ros.console.progress.time.monotonic", lambda: next(times))
    progress = Progress(stream)
    progress.begin("goal")
    for note in ("a", "b", "c", "d"):
        progress.update(0.5, note)
    assert [line.split() for line in stream.getvalue().splitlines()] == [
        ["goal", "b"],
        ["goal", "d"],
    ]


def test_a_result_that_is_saved_is_not_printed(tmp_path, capsys):
    path = results.save("demo", {"error_mm": 1.5}, tmp_path)
    assert json.loads(path.read_text())["error_mm"] == 1.5
    assert not capsys.readouterr().out


def test_progress_is_a_bar_on_a_terminal_and_never_wraps(terminal, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    progress = Progress(terminal)
    progress.begin("forward")
    monkeypatch.setattr("omniman_ros.console.progress.REDRAW_PERIOD", 0.0)
    progress.update(0.5, "a note " * 20)
    drawn = terminal.getvalue().split("\r")[-1]
    assert "█" * 12 + "\033" in drawn
    assert len(drawn.replace("\033[2m", "").replace("\033[0m", "").replace("\033[K", "")) < 60
    progress.end("done")
    assert terminal.getvalue().endswith("\n")


def test_colours_need_a_terminal_and_no_no_color(terminal, monkeypatch):
    assert paint("text", "31", terminal) == "\033[31mtext\033[0m"
    assert paint("text", "31", io.StringIO()) == "text"
    monkeypatch.setenv("NO_COLOR", "1")
    assert paint("text", "31", terminal) == "text"


def test_writing_to_a_closed_terminal_is_no_error(terminal):
    terminal.close()
    say("text", terminal)


def test_the_columns_of_a_table_are_aligned():
    lines = table([("", "value"), ("a long name", "1.0"), ("b", "10.00")])
    assert lines == ["               value", "  a long name    1.0", "  b            10.00"]
