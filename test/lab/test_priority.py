import os
import subprocess
import sys

import pytest

from omniman_ros.lab.priority import set_niceness

IDLE = "import sys, threading; threading.Thread(target=sys.stdin.read).start(); print(flush=True)"


@pytest.fixture(params=[False, True], ids=["child", "leader of a session"])
def idle(request):
    """A process with two threads that leads a session, or does not."""
    with subprocess.Popen(
        [sys.executable, "-c", IDLE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=request.param,
    ) as process:
        process.stdout.readline()
        yield process.pid, request.param
        process.stdin.close()


@pytest.mark.processes
def test_all_threads_and_a_session_of_its_own_get_the_niceness(idle, tmp_path):
    pid, leads = idle
    account = tmp_path / str(pid) / "autogroup"
    account.parent.mkdir()
    account.write_text("unchanged")
    assert set_niceness(pid, 7, tmp_path)
    threads = os.listdir(f"/proc/{pid}/task")
    assert len(threads) == 2
    assert {os.getpriority(os.PRIO_PROCESS, int(thread)) for thread in threads} == {7}
    assert account.read_text() == ("7" if leads else "unchanged")


@pytest.mark.processes
def test_a_kernel_without_groups_of_processes_permits_it(idle, tmp_path):
    assert set_niceness(idle[0], 7, tmp_path)


def test_a_process_that_is_gone_has_no_niceness():
    assert not set_niceness(999999999, 7)


@pytest.mark.processes
@pytest.mark.parametrize(
    ("group", "within", "after"), [("/autogroup-12 nice 3\n", "12", "3"), ("", "", "")]
)
def test_a_process_takes_its_own_niceness_back(tmp_path, group, within, after):
    account = tmp_path / "self" / "autogroup"
    account.parent.mkdir()
    account.write_text(group)
    code = (
        "import os, sys\nfrom pathlib import Path\n"
        "from omniman_ros.lab.priority import own_niceness\n"
        "root = Path(sys.argv[1])\n"
        "def look(): print(os.getpriority(0, 0), (root / 'self' / 'autogroup').read_text())\n"
        "print(os.nice(2))\n"
        "with own_niceness(12, root): look()\n"
        "look()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True
    )
    before, *seen = done.stdout.splitlines()  # that of the tests may be above zero
    niceness = before if os.geteuid() == 0 else "12"
    assert seen == [f"12 {within}", f"{niceness} {after}"]
