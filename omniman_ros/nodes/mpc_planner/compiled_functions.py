"""Functions of the planner's solvers, compiled in the background if there is a C compiler."""

import hashlib
import os
import shutil
import signal
import subprocess
import tempfile
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path

import casadi as ca

from omniman_ros.planning.mpc.solver import Solver

COMPILER = "cc"
#: Options of the compiler: without contractions of products and sums, so that the results are
#: those of casadi's virtual machine to the last bit
OPTIONS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
NICE = ("nice", "-n", "19")  #: What keeps the compiler from delaying the robot
LONGEST_REASON = 200  #: Length to which the reason of a failure is cut
DIGEST = hashlib.sha256().digest_size  #: Number of bytes of the digest at the end of a library


def default_folder() -> Path:
    """Return the folder for compiled functions, which may be deleted at any time."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(cache, "omniman_ros")


class CompiledFunctions:
    """Hands compiled functions to solvers, one solver after the other.

    A library is named by the code and the compiler, ends with its digest, as loading one that is
    damaged may end the process, and is kept for the next start. What fails is reported once; the
    solvers then go on with casadi's virtual machine.

    Args:
        solvers: Solvers whose functions are to be compiled.
        folder: Where libraries are kept.
        report: Called with what there is to say.

    Attributes:
        failure: Why not all solvers use compiled functions, or empty.
    """

    def __init__(
        self, solvers: Iterable[Solver], folder: Path, report: Callable[[str], None]
    ) -> None:
        self._report, self._folder = report, folder
        # Code is generated before the robot drives: it takes as long as a cycle.
        self._waiting = deque((solver, solver.transcription.c_code()) for solver in solvers)
        self._running: subprocess.Popen[bytes] | None = None
        self._files = ExitStack()
        self._library = self._made = self._complaints = Path()
        self._count, self.failure = len(self._waiting), ""
        self._version = _version()
        if not self._version:
            self._end(f"there is no C compiler `{COMPILER}`")
        elif not folder.is_absolute():
            self._end("there is no home folder to keep them in")

    @property
    def is_done(self) -> bool:
        """Whether nothing more is to be done."""
        return not self._waiting

    def poll(self) -> None:
        """Do one step that takes a few milliseconds: to be called between two cycles."""
        if self.is_done:
            return
        try:
            if self._running is None:
                self._begin()
            elif self._running.poll() is not None:
                is_made, self._running = not self._running.returncode, None
                self._take(is_made)
        except (OSError, RuntimeError) as error:  # the latter are those of casadi
            self._end(str(error))

    def close(self) -> None:
        """Stop what is running."""
        self._waiting.clear()
        if self._running is not None:
            os.killpg(self._running.pid, signal.SIGKILL)  # the compiler has children
            self._running.wait()
            self._running = None
        self._files.close()

    def _begin(self) -> None:
        """Use the library of the next solver, or start its compilation."""
        _, code = self._waiting[0]
        contents = "\0".join((code, self._version, *OPTIONS))
        name = hashlib.sha256(contents.encode()).hexdigest()[:32]
        self._library = self._folder / f"{name}.so"
        if self._library.exists():
            self._use()
            return
        self._files.close()
        files = self._files.enter_context(tempfile.TemporaryDirectory(prefix="omniman_compile_"))
        source, self._made, self._complaints = (
            Path(files, f"functions.{kind}") for kind in ("c", "so", "txt")
        )
        source.write_text(code)
        with open(self._complaints, "w") as complaints:
            self._running = subprocess.Popen(
                [*NICE, COMPILER, *OPTIONS, "-o", self._made, source, "-lm"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=complaints,
                start_new_session=True,
            )

    def _take(self, is_made: bool) -> None:
        """Keep the library that the compiler has made, and use it."""
        if not is_made:
            self._end(self._complaints.read_text(errors="replace").strip() or "cc has failed")
            return
        made = self._made.read_bytes()
        self._folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as kept:
            kept.write(made + hashlib.sha256(made).digest())
        Path(kept.name).replace(self._library)  # at once, for those who start at the same time
        self._use()

    def _use(self) -> None:
        solver, _ = self._waiting[0]
        t, path, kept = solver.transcription, str(self._library), self._library.read_bytes()
        is_whole = hashlib.sha256(kept[:-DIGEST]).digest() == kept[-DIGEST:]
        functions = t.program, t.rollout
        if not is_whole or not solver.take_over(*(ca.external(f.name(), path) for f in functions)):
            self._library.unlink()
            self._end(f"{path} is not what its name says, and was removed")
            return
        self._waiting.popleft()
        if not self._waiting:
            self._report(f"plans are computed by compiled functions ({self._count} problems)")
            self.close()

    def _end(self, why: str) -> None:
        self.failure = why = why[:LONGEST_REASON]
        self._report(f"plans are computed by casadi's virtual machine: {why}")
        self.close()


def _version() -> str:
    """Return the version of the compiler, or an empty string if there is none."""
    if shutil.which(COMPILER) is None:
        return ""
    found = subprocess.run([COMPILER, "--version"], capture_output=True, text=True, check=False)
    return found.stdout.strip()
