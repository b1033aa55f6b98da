"""acados as a peer: it solves the planner's program."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.lab.bench import mpc_acados
from omniman_ros.lab.bench.mpc_acados import AcadosClient, is_installed
from omniman_ros.lab.bench.mpc_rig import Rig, Task
from omniman_ros.planning.mpc import quadratic_program
from omniman_ros.planning.mpc.quadratic_program import TOLERANCES
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.robots import robot_parameters

SCENES, STEPS = 3, 8  # of drives
#: Tolerances, with which acados solves most tasks: with the planner's, currents differ by mA
TIGHT = 1e-7


def at_an_obstacle(task, solver, random):
    """A task in which the trust region binds, or slack is worth its price."""
    limit, start = solver.transcription.model.max_current, task.start.copy()
    start[:2] = task.stage.obstacles[0, 0, :2] + random.uniform(-0.8, 0.8, 2)
    guess = random.uniform(-0.1, 0.1, task.guess.shape) * limit
    states, stage = solver.states(start, guess), replace(task.stage, slack=(5.0, 50.0))
    return Task(task.first, start, guess, states, stage)


@pytest.mark.processes
@pytest.mark.skipif(not is_installed(), reason="acados is not installed")
@pytest.mark.parametrize("robot", ["ig42", "omniman"])
def test_acados_finds_the_currents_of_the_planners_program(robot, monkeypatch):
    for name in TOLERANCES:
        monkeypatch.setitem(quadratic_program.TOLERANCES, name, TIGHT)
    rig = Rig(robot_parameters(robot), 20, 2)
    solver, random = Solver(rig.transcription), np.random.default_rng(5)
    drives = [rig.steps(rig.scene(seed), rig.plan, STEPS, lambda: 0.0) for seed in range(SCENES)]
    tasks = [step.task for drive in drives for step in drive]
    tasks += [at_an_obstacle(task, solver, random) for task in tasks]
    differences = []
    with AcadosClient(rig.transcription) as acados:
        for task in tasks:
            theirs, is_solved, seconds = acados.plan(task)
            assert 0.0 < seconds < 1.0
            ours = solver.solve(task.start, task.guess, task.stage).currents
            if is_solved:
                differences.append(np.abs(theirs - ours).max())
    assert len(differences) > 0.5 * len(tasks)
    assert max(differences) < 1e-4


def test_acados_needs_a_folder_that_has_it_and_a_compiler(tmp_path, monkeypatch):
    monkeypatch.delenv(mpc_acados.FOLDER, raising=False)
    assert not is_installed()
    monkeypatch.setenv(mpc_acados.FOLDER, str(tmp_path))
    assert not is_installed()
    (tmp_path / "acados" / "acados_template").mkdir(parents=True)
    for program in ("make", "cc"):
        (tmp_path / program).write_text("")
        (tmp_path / program).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert is_installed()
    (tmp_path / "cc").unlink()
    assert not is_installed()


@pytest.mark.processes
def test_an_error_of_acados_process_shows_the_end_of_its_output(tmp_path, monkeypatch):
    monkeypatch.setenv(mpc_acados.FOLDER, str(tmp_path))
    rig = Rig(robot_parameters("ig42"), 4, 1)
    (step,) = rig.steps(rig.scene(0), rig.plan, 1, lambda: 0.0)
    with (
        AcadosClient(rig.transcription) as acados,
        pytest.raises(RuntimeError, match=r"acados has ended\n(.*\n)+.*No module named 'acados"),
    ):
        acados.plan(step.task)
