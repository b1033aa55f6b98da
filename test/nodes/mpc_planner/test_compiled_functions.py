"""Compiled functions: used when they are the same, kept, and done without when anything fails."""

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from omniman_ros.nodes.mpc_planner import compiled_functions
from omniman_ros.nodes.mpc_planner.compiled_functions import (
    CompiledFunctions,
    default_folder,
)
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.mpc.transcription import Transcription
from test.planning.support import model
from test.running import PATIENCE

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler `cc`")


@pytest.fixture(autouse=True)
def compiler(monkeypatch):
    """Use the compiler that the other tests do without."""
    monkeypatch.setattr(compiled_functions, "COMPILER", "cc")


def a_solver(damping=8.0):
    return Solver(Transcription(model("ig42"), 2, 0.1, 0, confined=False, damping=damping))


def finished(solver, folder):
    """Compile a solver's functions, and return what was said."""
    said = []
    compiled = CompiledFunctions([solver], folder, said.append)
    end = time.monotonic() + PATIENCE
    while not compiled.is_done:
        assert time.monotonic() < end
        compiled.poll()
    return said


def functions(solver):
    return solver._program, solver._rollout


def outcome(solver):
    """Return the states that follow from some currents."""
    random = np.random.default_rng(1)
    return solver.states(random.uniform(-1, 1, 6), random.uniform(-1, 1, (2, 4)))


@needs_compiler
def test_functions_are_compiled_once_and_return_the_same(tmp_path, monkeypatch):
    solver = a_solver()
    before, states = functions(solver), outcome(solver)
    assert finished(solver, tmp_path / "new") == [
        "plans are computed by compiled functions (1 problems)"
    ]
    assert not set(functions(solver)) & set(before)
    np.testing.assert_array_equal(outcome(solver), states)
    assert [path.suffix for path in (tmp_path / "new").iterdir()] == [".so"]
    monkeypatch.setattr(compiled_functions, "NICE", ("false",))  # nothing is compiled again
    other = a_solver()
    assert "compiled functions" in finished(other, tmp_path / "new")[0]


@needs_compiler
@pytest.mark.parametrize("kind", ["other", "garbage", "truncated", "empty"])
def test_a_library_that_is_not_what_its_name_says_is_not_used(tmp_path, kind):
    finished(a_solver(), tmp_path)
    (library,) = tmp_path.iterdir()
    whole = library.read_bytes()
    damaged = {"garbage": b"garbage", "truncated": whole[: len(whole) // 2], "empty": b""}
    if kind in damaged:
        library.write_bytes(damaged[kind])
    else:
        finished(a_solver(damping=1.0), tmp_path)
        (other,) = set(tmp_path.iterdir()) - {library}
        other.replace(library)
    solver = a_solver()
    before = functions(solver)
    (said,) = finished(solver, tmp_path)
    assert "virtual machine: " in said and functions(solver) == before
    assert not library.exists()
    assert "compiled functions" in finished(solver, tmp_path)[0], "made anew at the next start"


@needs_compiler
def test_what_a_compiler_that_was_killed_leaves_is_not_used(tmp_path, monkeypatch):
    killed = 'echo part > "$6"; kill -9 $$'  # $0 is the compiler; four options and -o
    monkeypatch.setattr(compiled_functions, "NICE", ("sh", "-c", killed))
    solver = a_solver()
    before = functions(solver)
    (said,) = finished(solver, tmp_path / "folder")
    assert "cc has failed" in said and functions(solver) == before
    assert not (tmp_path / "folder").exists()


def test_without_a_home_it_is_said_once_and_nothing_changes():
    assert "no home folder" in finished(a_solver(), Path("~/.cache"))[0]


def test_without_a_compiler_it_is_said_once_and_nothing_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_functions, "COMPILER", "no_such_compiler")
    solver = a_solver()
    before = functions(solver)
    assert finished(solver, tmp_path) == [
        "plans are computed by casadi's virtual machine: there is no C compiler `no_such_compiler`"
    ]
    assert functions(solver) == before


@needs_compiler
@pytest.mark.parametrize("where", ["compiler", "folder"])
def test_a_failure_is_reported_once_and_nothing_changes(tmp_path, monkeypatch, where):
    folder = tmp_path / "folder"
    if where == "compiler":
        monkeypatch.setattr(compiled_functions, "OPTIONS", ("-no-such-option",))
        why = "no-such-option"
    else:
        folder.write_text("a file")
        why = "File exists"
    solver = a_solver()
    before = functions(solver)
    (said,) = finished(solver, folder)
    assert why in said and functions(solver) == before


@needs_compiler
def test_the_end_of_the_node_ends_the_compiler(tmp_path):
    compiled = CompiledFunctions([a_solver()], tmp_path, pytest.fail)
    compiled.poll()
    running = compiled._running
    assert running is not None and running.poll() is None
    compiled.close()
    assert running.poll() is not None and compiled.is_done
    compiled.poll()
    compiled.close()


def test_libraries_are_kept_where_caches_are(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "omniman_ros"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "omniman_ros"
