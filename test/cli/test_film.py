"""`omniman film` of recordings that the tests write."""

import math

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")
pytest.importorskip("PIL")

from PIL import Image

from omniman_ros import extras
from omniman_ros.cli.main import main
from test.recording import support as s


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A recording of 3 s on a circle."""
    rows = [(0.0, "/active_source", s.text("cmd_vel")), (3.0, "/active_source", s.text("none"))]
    for k in range(31):
        time = 0.1 * k
        pose = (math.sin(time), 1.0 - math.cos(time), time)
        rows.append((time, "/odom", s.odometry(time, pose, (1.0, 0.0, 1.0))))
    return s.write(tmp_path_factory.mktemp("drive") / "drive", rows)


def test_a_film_of_a_drive_is_written_and_reported(drive, tmp_path, capsys):
    path = tmp_path / "new" / "circle.webp"
    options = ["--output", str(path), "--width", "160", "--rate", "4", "--duration", "2"]
    assert main(["film", str(drive), *options]) == 0
    film = Image.open(path)
    assert (film.format, film.size, film.n_frames) == ("WEBP", (160, 90), 8)
    printed = capsys.readouterr().out
    assert "cmd_vel    3.0 s at 1.5x" in printed
    assert f"Film: {path}, 2.0 s" in printed


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--width", "161"], 2, "--width must be a multiple of 16, got 161"),
        (["--duration", "0"], 2, "--duration must be 1 to 300, got 0"),
        (["--rate", "nan"], 2, "--rate must be 1 to 50, got nan"),
        (["--size", "0.01"], 2, "--size must be 0.05 to 1000, got 0.01"),
        (["--robot", "nobody"], 2, "nobody"),
        (["--namespace", "r2"], 2, "there is no robot 'r2'"),
    ],
)
def test_options_that_cannot_be_used_are_refused(drive, tmp_path, capsys, options, code, message):
    path = tmp_path / "film.webp"
    assert main(["film", str(drive), "--output", str(path), *options]) == code
    assert message in capsys.readouterr().err
    assert not path.exists()


def test_a_recording_in_which_nothing_drove_has_no_film(tmp_path, capsys):
    bag = s.write(tmp_path / "bag", [(1.0, "/odom", s.odometry(1.0, (0.0, 0.0, 0.0)))])
    assert main(["film", str(bag)]) == 1
    assert "no source drove the platform" in capsys.readouterr().err


def test_without_the_library_the_error_says_how_to_install_it(drive, monkeypatch, capsys):
    monkeypatch.setattr(
        "omniman_ros.cli.film.FILM", extras.Extra(("no_such_module",), "films need it", "thing")
    )
    assert main(["film", str(drive)]) == 1
    assert "films need it: pip install thing" in capsys.readouterr().err
