import fcntl
import os

from test.shared_memory import remove_abandoned


def make(folder, name, age=100.0):
    """Make the files of a port; return its lock."""
    paths = [folder / f"fastrtps_{name}{end}" for end in ("", "_el")]
    paths.append(folder / f"sem.fastrtps_{name}_mutex")
    for path in paths:
        path.write_bytes(b"")
        os.utime(path, (path.stat().st_mtime - age,) * 2)
    return paths[1]


def test_what_nobody_holds_is_removed_and_nothing_else(tmp_path):
    make(tmp_path, "port7413")
    held = make(tmp_path, "port7000")
    make(tmp_path, "new", age=1.0)
    (tmp_path / "lttng-ust-wait-6").write_bytes(b"")
    with held.open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_abandoned(tmp_path) == 1
        assert remove_abandoned(tmp_path) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert not [name for name in names if "port7413" in name]
    assert len([name for name in names if "port7000" in name]) == 3
    assert len([name for name in names if "new" in name]) == 3
    assert "lttng-ust-wait-6" in names


def test_a_machine_without_shared_memory_has_nothing_to_remove(tmp_path):
    assert remove_abandoned(tmp_path / "missing") == 0
