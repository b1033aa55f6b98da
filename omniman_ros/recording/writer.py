"""Writing of rosbag2 recordings (MCAP) in a thread, so that receiving never waits for the disk.

Messages that do not fit into the queue, because the disk is too slow, are dropped and counted.
"""

import threading
from collections import Counter, deque
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from omniman_ros.core.errors import InputError
from omniman_ros.recording.topic_metadata import OfferedQos, TopicMetadata

METADATA_VERSION: Final = 9  #: Version of the recording's metadata, that of ROS 2 Jazzy
MAX_QUEUED_BYTES = 64 * 2**20  #: Size of the messages that may wait to be written [bytes]
#: Infinite duration of ROS 2's middleware interface (rmw)
INFINITE_TIME = QosTime(9223372036, 854775807)

_Message = tuple[str, int, bytes]  #: Topic, time of arrival [ns] and serialised message


def bag_qos(offered: OfferedQos) -> Qos:
    """Return the quality of service that a publisher offers, as a recording stores it."""
    return Qos(
        QosHistory.KEEP_LAST if offered.depth else QosHistory.UNKNOWN,
        offered.depth,
        QosReliability.RELIABLE if offered.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if offered.transient_local else QosDurability.VOLATILE,
        INFINITE_TIME,
        INFINITE_TIME,
        QosLiveliness.AUTOMATIC,
        INFINITE_TIME,
        False,
    )


class BagWriter:
    """Writer of a recording in a thread, as a context manager; its end completes the recording.

    Args:
        max_queued_bytes: Size of the messages that may wait to be written [bytes].

    Attributes:
        failure: Reason why writing has ended early, or an empty string.

    Raises:
        InputError: The folder exists, or cannot be created.
    """

    def __init__(self, folder: Path, max_queued_bytes: int = MAX_QUEUED_BYTES) -> None:
        self.folder = folder
        self.written: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.failure = ""
        self._max_queued_bytes = max_queued_bytes
        self._queue: deque[TopicMetadata | _Message] = deque()
        self._batch: deque[TopicMetadata | _Message] = deque()
        self._queued_bytes = 0
        self._is_closing = False
        self._changed = threading.Condition()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(
                folder, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.open()
        except (WriterError, OSError) as error:
            raise InputError(f"cannot record to {folder}: {error}") from error
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the queued messages and the index."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join()

    @property
    def size(self) -> int:
        """Size of the recording's files so far [bytes]."""
        return sum(file.stat().st_size for file in self.folder.iterdir())

    def add_topic(self, topic: TopicMetadata) -> None:
        """Add a topic, before its first message."""
        with self._changed:
            self._queue.append(topic)
            self._changed.notify()

    def put(self, topic: str, stamp: int, data: bytes) -> bool:
        """Queue a message (CDR), or count it as dropped; return whether it is queued."""
        with self._changed:
            if self.failure or self._queued_bytes + len(data) > self._max_queued_bytes:
                self.dropped[topic] += 1
                return False
            self._queued_bytes += len(data)
            self._queue.append((topic, stamp, data))
            self._changed.notify()
        return True

    def _run(self) -> None:
        try:
            while self._write_queued():
                pass
            self._writer.close()
        except (OSError, WriterError) as error:
            with self._changed:
                self.failure = str(error)
                self._drop_all()

    def _write_queued(self) -> bool:
        with self._changed:
            while not self._queue and not self._is_closing:
                self._changed.wait()
            self._batch, self._queue = self._queue, deque()
        while self._batch:
            self._write(self._batch[0])
            self._batch.popleft()
        return bool(self._queue) or not self._is_closing

    def _write(self, item: TopicMetadata | _Message) -> None:
        if isinstance(item, TopicMetadata):
            self._connections[item.name] = self._writer.add_connection(
                item.name,
                item.message_type,
                msgdef=item.definition,
                rihs01=item.type_hash,
                offered_qos_profiles=[bag_qos(offered) for offered in item.offered_qos],
            )
            return
        topic, stamp, data = item
        self._writer.write(self._connections[topic], stamp, data)
        self.written[topic] += 1
        with self._changed:
            self._queued_bytes -= len(data)

    def _drop_all(self) -> None:
        for item in (*self._batch, *self._queue):
            if not isinstance(item, TopicMetadata):
                self.dropped[item[0]] += 1
        self._batch.clear()
        self._queue.clear()
