import io

import numpy as np
import pytest

pytest.importorskip("PIL")

from PIL import Image

from omniman_ros.core.errors import InputError
from omniman_ros.recording.film.encoding import LAST_FRAME, QUALITIES, encoded, write_film


@pytest.fixture(scope="module")
def frames():
    noise = np.random.default_rng(1).integers(0, 256, (3, 32, 48, 3), dtype=np.uint8)
    return [Image.fromarray(each) for each in noise]


def test_frames_are_repeated_forever_and_the_last_one_stays(frames):
    film = Image.open(io.BytesIO(encoded(frames, 12.0, 50)))
    durations = []
    for number in range(film.n_frames):
        film.seek(number)
        film.load()
        durations.append(film.info["duration"])
    assert durations == [83, 84, 83 + round(1e3 * LAST_FRAME)]
    assert (film.size, film.info["loop"]) == ((48, 32), 0)


def test_the_best_quality_is_chosen_that_is_small_enough(frames, tmp_path):
    sizes = [len(encoded(frames, 12.0, quality)) for quality in QUALITIES]
    assert sorted(sizes, reverse=True) == sizes
    tried = []
    path = tmp_path / "film.webp"
    size = write_film(frames, 12.0, path, sizes[3], lambda *each: tried.append(each))
    assert size == path.stat().st_size == sizes[3]
    assert tried == list(zip(QUALITIES, sizes, strict=True))[:4]


def test_a_film_that_is_too_large_at_the_lowest_quality_is_refused(frames, tmp_path):
    with pytest.raises(InputError, match="expected at most 100"):
        write_film(frames, 12.0, tmp_path / "film.webp", 100)
    assert not (tmp_path / "film.webp").exists()
