import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import output_errors, write_atomically, write_file_or_stdout


def test_a_file_is_replaced_as_a_whole_and_its_folder_created(tmp_path):
    path = tmp_path / "new" / "file.txt"
    write_atomically(path, "old")
    write_atomically(path, "new")
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(path.parent.iterdir()) == [path]


def test_output_goes_to_the_file_or_to_stdout(tmp_path, capsys):
    write_file_or_stdout(None, "ä\n")
    assert capsys.readouterr().out == "ä\n"
    path = tmp_path / "file.txt"
    write_file_or_stdout(str(path), "ä\n")
    assert path.read_bytes() == "ä\n".encode()
    assert not capsys.readouterr().out


def test_a_file_that_cannot_be_written_is_an_error_of_the_option(tmp_path):
    path = str(tmp_path / "missing" / "file.txt")
    with pytest.raises(CommandError, match=f"--output {path}: No such file or directory"):
        write_file_or_stdout(path, "text")


def test_only_errors_of_writing_are_those_of_the_option():
    with pytest.raises(ValueError, match="other"), output_errors("file"):
        raise ValueError("other")
