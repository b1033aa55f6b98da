"""Recordings whose process was killed."""

import shutil
import subprocess
import sys
import time

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from mcap.reader import NonSeekingReader

from omniman_ros.core.errors import InputError
from omniman_ros.recording.reader import BagReader, finish_copy, is_unfinished
from test.recording import support as s

COUNT = 12_000
RECORDING = """
import sys
from pathlib import Path
from omniman_ros.recording.writer import BagWriter
from test.recording import support as s
from test.recording.test_bag_writer import STRING, topic
data = bytes(s.STORE.serialize_cdr(s.text("hello " * 80), STRING))
writer = BagWriter(Path(sys.argv[1])).__enter__()
writer.add_topic(topic())
for stamp in range({count}):
    writer.put("/greeting", stamp, data)
print("queued", flush=True)
input()
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Return the folder of a recording whose process was killed."""
    folder = tmp_path_factory.mktemp("killed") / "bag"
    code = RECORDING.format(count=COUNT)
    command = [sys.executable, "-c", code, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        end, sizes = time.monotonic() + 60.0, [0, 1]
        while sizes[-1] != sizes[-2] or sizes[-1] < 1000:  # until the queue is on the disk
            assert time.monotonic() < end
            time.sleep(0.2)
            sizes.append(next(folder.glob("*.mcap")).stat().st_size)
        process.kill()
    return folder


def stamps(path):
    with BagReader(path) as bag:
        assert bag.is_unfinished
        return [round(arrival * 1e9) for _, arrival, _ in bag.messages(["/greeting"])]


@pytest.mark.processes
def test_all_but_the_last_chunk_is_read(killed):
    before = {file: file.read_bytes() for file in killed.iterdir()}
    read = stamps(killed)
    assert read == list(range(len(read))) and len(read) > 0.7 * COUNT
    assert stamps(next(killed.glob("*.mcap"))) == read
    assert {file: file.read_bytes() for file in killed.iterdir()} == before, "it is left alone"


def recorded(folder):
    path = s.write(folder / "whole", [(k, "/odom", s.odometry(k, (k, 0, 0))) for k in range(20)])
    (file,) = path.glob("*.mcap")
    return path, file


def test_a_file_may_end_anywhere(tmp_path):
    _, whole = recorded(tmp_path)
    data = whole.read_bytes()
    cut, copy = tmp_path / "cut.mcap", tmp_path / "copy.mcap"
    counts = []
    for size in range(8, len(data), 37):
        cut.write_bytes(data[:size])
        assert is_unfinished(cut)
        finish_copy(cut, copy)
        assert not is_unfinished(copy)
        with copy.open("rb") as file:  # read by a library that did not write it
            counts.append(len(list(NonSeekingReader(file).iter_messages())))
    assert set(counts) == {0, 20} and counts == sorted(counts)


def test_whole_files_and_others_are_not_unfinished(tmp_path):
    path, whole = recorded(tmp_path)
    assert not is_unfinished(whole)
    with BagReader(path) as bag:
        assert not bag.is_unfinished
    for content in (b"", b"\x89MC", b"something else"):
        other = tmp_path / "other.mcap"
        other.write_bytes(content)
        assert not is_unfinished(other)
        with pytest.raises(InputError, match="other"), BagReader(other):
            pass


def test_without_a_message_there_is_nothing_to_read(tmp_path):
    _, whole = recorded(tmp_path)
    folder = tmp_path / "begun"
    folder.mkdir()
    (folder / "begun.mcap").write_bytes(whole.read_bytes()[:60])
    with BagReader(folder) as bag:
        assert bag.is_unfinished and bag.topic_types == {}
    shutil.rmtree(folder)
