import threading

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

import yaml
from mcap.reader import make_reader

from omniman_ros.bag.definitions import Definitions
from omniman_ros.bag.reader import BagReader
from omniman_ros.bag.topic import Offer, Topic
from omniman_ros.bag.writer import BagWriter
from omniman_ros.core.errors import InputError

from . import support

KIND = "std_msgs/msg/String"
DATA = bytes(support.STORE.serialize_cdr(support.text("hello"), KIND))


def topic(name="/said", *offers):
    return Topic(name, KIND, *Definitions().of(KIND), offers)


def test_all_that_is_given_is_in_the_recording_in_its_order(tmp_path):
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        writer.add(topic())
        for stamp in range(500):
            assert writer.put("/said", 10**9 + stamp, DATA)
    assert writer.written == {"/said": 500} and not writer.dropped
    with BagReader(folder) as bag:
        heard = list(bag.messages(["/said"]))
        assert bag.kinds == {"/said": KIND}
    assert [round(arrival * 1e9) - 10**9 for _, arrival, _ in heard] == list(range(500))
    assert {message.data for _, _, message in heard} == {"hello"}


def test_a_library_of_others_reads_it_as_one_of_ros_2(tmp_path):
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        writer.add(topic("/said", Offer(latched=True, depth=0), Offer(reliable=False)))
        writer.put("/said", 7, DATA)
    with (folder / "bag.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        ((schema, channel, message),) = reader.iter_messages()
    assert (schema.name, schema.encoding) == (KIND, "ros2msg")
    assert schema.data.decode().strip() == "string data"
    assert (channel.topic, channel.message_encoding) == ("/said", "cdr")
    assert (message.log_time, message.data) == (7, DATA)
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    (known,) = information["topics_with_message_count"]
    first, second = known["topic_metadata"]["offered_qos_profiles"]
    assert (first["durability"], first["reliability"]) == ("transient_local", "reliable")
    assert (second["durability"], second["reliability"]) == ("volatile", "best_effort")


def test_what_does_not_fit_is_dropped_and_counted_and_the_rest_is_written(tmp_path, monkeypatch):
    gate = threading.Event()
    write = BagWriter._write

    def slow(self, item):
        assert gate.wait(10.0)
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", slow)
    with BagWriter(tmp_path / "bag", limit=5 * len(DATA)) as writer:
        writer.add(topic())
        taken = [writer.put("/said", stamp, DATA) for stamp in range(8)]
        gate.set()
    assert taken == [True] * 5 + [False] * 3
    assert writer.written == {"/said": 5}
    assert writer.dropped == {"/said": 3}


def test_what_is_written_makes_room(tmp_path, monkeypatch):
    done = threading.Semaphore(0)
    write = BagWriter._write

    def told(self, item):
        write(self, item)
        done.release()

    monkeypatch.setattr(BagWriter, "_write", told)
    with BagWriter(tmp_path / "bag", limit=len(DATA)) as writer:
        writer.add(topic())
        assert done.acquire(timeout=10.0)
        for stamp in range(20):
            assert writer.put("/said", stamp, DATA)
            assert done.acquire(timeout=10.0)
    assert writer.written == {"/said": 20}


def test_what_came_before_the_end_is_written_though_it_still_waits(tmp_path, monkeypatch):
    begun = threading.Event()
    write = BagWriter._write

    def after_the_end(self, item):
        begun.set()
        with self._news:
            assert self._news.wait_for(lambda: self._ended, timeout=10.0)
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", after_the_end)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add(topic())
        assert begun.wait(10.0)
        for stamp in range(3):
            assert writer.put("/said", stamp, DATA)
    assert writer.written == {"/said": 3}


def test_a_full_disk_ends_the_writing_and_what_is_lost_is_counted(tmp_path, monkeypatch):
    write = BagWriter._write

    def full(self, item):
        if isinstance(item, tuple) and item[1] == 3:
            raise OSError("no space left on device")
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", full)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add(topic())
        for stamp in range(6):
            writer.put("/said", stamp, DATA)
    assert "no space" in writer.failure
    assert writer.written["/said"] == 3
    assert writer.written["/said"] + writer.dropped["/said"] == 6
    assert not writer.put("/said", 9, DATA)


def test_a_folder_that_exists_is_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(InputError, match="exists"):
        BagWriter(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("name", ["nothing", "empty"])
def test_what_is_no_recording_is_refused_by_name(tmp_path, name):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=name), BagReader(tmp_path / name):
        pass
