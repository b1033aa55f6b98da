"""acados as a peer in `omniman bench mpc`: the client of its process."""

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from omniman_ros.core.arrays import Array
from omniman_ros.lab.bench.mpc_acados_peer import PeerProblem
from omniman_ros.lab.bench.mpc_rig import Task
from omniman_ros.planning.mpc.quadratic_program import TOLERANCES
from omniman_ros.planning.mpc.transcription import Transcription

FOLDER = "OMNIMAN_ACADOS"  #: environment variable with the folder that has acados
LOG_LINES = 10  #: number of lines of the process's output that an error shows


def is_installed() -> bool:
    """Return whether there is a folder with acados, and a compiler for what it generates."""
    folder = Path(os.environ.get(FOLDER, ""), "acados", "acados_template")
    return folder.is_dir() and None not in map(shutil.which, ("make", "cc"))


class AcadosClient:
    """acados in a process of its own, which ends with this context.

    Raises:
        RuntimeError: The process has ended before.
    """

    def __init__(self, transcription: Transcription) -> None:
        t, root = transcription, Path(os.environ[FOLDER]).absolute()
        package, install = root / "acados" / "acados_template", root / "acados" / "install"
        own = {
            "ACADOS_SOURCE_DIR": str(install),
            "ACADOS_PYTHON_INTERFACE_PATH": str(package),
            "PYTHONPATH": _before(root, "PYTHONPATH"),
            "LD_LIBRARY_PATH": _before(install / "lib", "LD_LIBRARY_PATH"),
        }
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 (closed at the end of the context)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "omniman_ros.lab.bench.mpc_acados_peer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=os.environ | own,
        )
        # The copy of the model has no functions of our casadi, unlike a model that was used.
        arguments = (t.steps, t.step, t.slots, t.confined, t.damping)
        self._send(PeerProblem(replace(t.model), arguments, TOLERANCES))

    def __enter__(self) -> "AcadosClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
        self._log.close()

    def plan(self, task: Task) -> tuple[Array, bool, float]:
        """Return currents (N, n) [A], whether they solve the task, and the CPU time [s].

        The time includes setting of values and reading of results, but not the pipes.
        """
        before = time.process_time()
        table = task.stage.table()
        own_time = time.process_time() - before
        self._send((task.start, task.guess, task.states, table))
        assert self._process.stdout is not None
        try:
            currents, solved, seconds = pickle.load(self._process.stdout)
        except EOFError:
            raise self._ended() from None
        return currents, solved, own_time + seconds

    def _send(self, item: Any) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(item, self._process.stdin)
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def _ended(self) -> RuntimeError:
        self._log.seek(0)
        last = self._log.read().decode(errors="replace").splitlines()[-LOG_LINES:]
        return RuntimeError("\n".join(["acados has ended", *last]))


def _before(folder: Path, variable: str) -> str:
    """Return the folders of an environment variable, with another one before them."""
    return os.pathsep.join(filter(None, [str(folder), os.environ.get(variable)]))
