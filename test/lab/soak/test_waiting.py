import pytest

from omniman_ros.lab.soak.waiting import PERIOD, WaitingWatch, waited


def account(proc, pid, thread, seconds):
    """Write the account of a thread as the system does: run, waited [ns], slices."""
    folder = proc / str(pid) / "task" / str(thread)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "schedstat").write_text(f"12345 {round(1e9 * seconds)} 67\n")


def test_the_longest_wait_of_any_thread_between_two_samples_counts(tmp_path):
    watch = WaitingWatch(tmp_path)
    account(tmp_path, 10, 10, 5.0)
    account(tmp_path, 10, 11, 1.0)
    account(tmp_path, 20, 20, 0.0)
    watch.look([10, 20], 0.0)
    assert watch.longest == 0.0, "what it waited before does not count"
    account(tmp_path, 10, 11, 1.15)
    account(tmp_path, 20, 20, 0.02)
    watch.look([10, 20], 0.5 * PERIOD)
    assert watch.longest == 0.0, "it is not due yet"
    watch.look([10, 20], PERIOD)
    assert watch.longest == pytest.approx(0.15)
    watch.clear()
    account(tmp_path, 20, 21, 9.0)
    watch.look([10, 20], 2.0 * PERIOD)
    assert watch.longest == 0.0, "a thread that is new has no sample before"


def test_a_process_that_has_ended_or_is_not_told_of_has_no_waits(tmp_path):
    account(tmp_path, 10, 10, 5.0)
    (tmp_path / "10" / "task" / "10" / "schedstat").write_text("")
    assert waited(10, tmp_path) == {} and waited(99, tmp_path) == {}
