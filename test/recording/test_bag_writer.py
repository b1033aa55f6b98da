import threading

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

import yaml
from mcap.reader import make_reader

from omniman_ros.core.errors import InputError
from omniman_ros.recording.definitions import MessageDefinitions
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.topic_metadata import OfferedQos, TopicMetadata
from omniman_ros.recording.writer import BagWriter
from test.recording import support

STRING = "std_msgs/msg/String"
DATA = bytes(support.STORE.serialize_cdr(support.text("hello"), STRING))


def topic(name="/greeting", *offered_qos):
    return TopicMetadata(name, STRING, *MessageDefinitions().lookup(STRING), offered_qos)


def test_all_messages_are_recorded_in_their_order(tmp_path):
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        writer.add_topic(topic())
        for stamp in range(500):
            assert writer.put("/greeting", 10**9 + stamp, DATA)
    assert writer.written == {"/greeting": 500} and not writer.dropped
    with BagReader(folder) as bag:
        messages = list(bag.messages(["/greeting"]))
        assert bag.topic_types == {"/greeting": STRING}
    assert [round(arrival * 1e9) - 10**9 for _, arrival, _ in messages] == list(range(500))
    assert {message.data for _, _, message in messages} == {"hello"}


def test_the_mcap_library_reads_a_recording_of_ros_2(tmp_path):
    folder = tmp_path / "bag"
    with BagWriter(folder) as writer:
        writer.add_topic(
            topic(
                "/greeting", OfferedQos(transient_local=True, depth=0), OfferedQos(reliable=False)
            )
        )
        writer.put("/greeting", 7, DATA)
    with (folder / "bag.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        ((schema, channel, message),) = reader.iter_messages()
    assert (schema.name, schema.encoding) == (STRING, "ros2msg")
    assert schema.data.decode().strip() == "string data"
    assert (channel.topic, channel.message_encoding) == ("/greeting", "cdr")
    assert (message.log_time, message.data) == (7, DATA)
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    (topic_information,) = information["topics_with_message_count"]
    first, second = topic_information["topic_metadata"]["offered_qos_profiles"]
    assert (first["durability"], first["reliability"]) == ("transient_local", "reliable")
    assert (second["durability"], second["reliability"]) == ("volatile", "best_effort")


def test_messages_that_do_not_fit_into_the_queue_are_dropped_and_counted(tmp_path, monkeypatch):
    gate = threading.Event()
    write = BagWriter._write

    def slow(self, item):
        assert gate.wait(10.0)
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", slow)
    with BagWriter(tmp_path / "bag", max_queued_bytes=5 * len(DATA)) as writer:
        writer.add_topic(topic())
        queued = [writer.put("/greeting", stamp, DATA) for stamp in range(8)]
        gate.set()
    assert queued == [True] * 5 + [False] * 3
    assert writer.written == {"/greeting": 5}
    assert writer.dropped == {"/greeting": 3}


def test_written_messages_leave_room_in_the_queue(tmp_path, monkeypatch):
    done = threading.Semaphore(0)
    write = BagWriter._write

    def signalling(self, item):
        write(self, item)
        done.release()

    monkeypatch.setattr(BagWriter, "_write", signalling)
    with BagWriter(tmp_path / "bag", max_queued_bytes=len(DATA)) as writer:
        writer.add_topic(topic())
        assert done.acquire(timeout=10.0)
        for stamp in range(20):
            assert writer.put("/greeting", stamp, DATA)
            assert done.acquire(timeout=10.0)
    assert writer.written == {"/greeting": 20}


def test_queued_messages_are_written_at_the_end(tmp_path, monkeypatch):
    has_begun = threading.Event()
    write = BagWriter._write

    def write_after_closing(self, item):
        has_begun.set()
        with self._changed:
            assert self._changed.wait_for(lambda: self._is_closing, timeout=10.0)
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", write_after_closing)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(topic())
        assert has_begun.wait(10.0)
        for stamp in range(3):
            assert writer.put("/greeting", stamp, DATA)
    assert writer.written == {"/greeting": 3}


def test_a_full_disk_ends_the_writing_and_lost_messages_are_counted(tmp_path, monkeypatch):
    write = BagWriter._write

    def full(self, item):
        if isinstance(item, tuple) and item[1] == 3:
            raise OSError("no space left on device")
        write(self, item)

    monkeypatch.setattr(BagWriter, "_write", full)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(topic())
        for stamp in range(6):
            writer.put("/greeting", stamp, DATA)
    assert "no space" in writer.failure
    assert writer.written["/greeting"] == 3
    assert writer.written["/greeting"] + writer.dropped["/greeting"] == 6
    assert not writer.put("/greeting", 9, DATA)


def test_an_existing_folder_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(InputError, match="exists"):
        BagWriter(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("name", ["nothing", "empty"])
def test_a_path_without_a_recording_is_refused_by_name(tmp_path, name):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=name), BagReader(tmp_path / name):
        pass
