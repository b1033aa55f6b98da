"""Writes a rosbag2 recording (MCAP) in a thread of its own, so that the one who hears never waits.

What does not fit into the queue, because the disk is too slow, is dropped and counted.
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

from omniman_ros.bag.topic import Offer, Topic
from omniman_ros.core.errors import InputError

VERSION: Final = 9
"""Of the metadata: that of ROS 2 Jazzy."""
LIMIT = 64 * 2**20
"""Bytes that may wait to be written."""
FOREVER = QosTime(9223372036, 854775807)
"""rmw's infinite duration."""


def offered_qos(offer: Offer) -> Qos:
    """What a publisher offers, in the words of a recording."""
    return Qos(
        QosHistory.KEEP_LAST if offer.depth else QosHistory.UNKNOWN,
        offer.depth,
        QosReliability.RELIABLE if offer.reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if offer.latched else QosDurability.VOLATILE,
        FOREVER, FOREVER, QosLiveliness.AUTOMATIC, FOREVER, False,
    )  # fmt: skip


class BagWriter:
    """A recording that is being written; as a context manager it is complete at the end.

    Args:
        folder: Where it goes; must not exist.
        limit: Bytes that may wait to be written.

    Attributes:
        folder: The same.
        written, dropped: Messages by topic.
        failure: Why no more is written, or empty.

    Raises:
        InputError: The folder exists, or cannot be made.
    """

    def __init__(self, folder: Path, limit: int = LIMIT) -> None:
        self.folder = folder
        self.written: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.failure = ""
        self._limit = limit
        self._queue: deque[Topic | tuple[str, int, bytes]] = deque()
        self._batch: deque[Topic | tuple[str, int, bytes]] = deque()
        self._waiting = 0
        self._ended = False
        self._news = threading.Condition()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise InputError(f"cannot record to {folder}: {error}") from error
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        """Write what waits, and the index."""
        with self._news:
            self._ended = True
            self._news.notify()
        self._thread.join()

    @property
    def size(self) -> int:
        """Bytes of the recording's files so far."""
        return sum(file.stat().st_size for file in self.folder.iterdir())

    def add(self, topic: Topic) -> None:
        """Announce a topic, before its first message."""
        with self._news:
            self._queue.append(topic)
            self._news.notify()

    def put(self, name: str, stamp: int, data: bytes) -> bool:
        """Give a message to be written.

        Args:
            name: Of its topic.
            stamp: When it was heard [ns].
            data: CDR, as it came.

        Returns:
            Whether it was taken; else it is counted as dropped.
        """
        with self._news:
            if self.failure or self._waiting + len(data) > self._limit:
                self.dropped[name] += 1
                return False
            self._waiting += len(data)
            self._queue.append((name, stamp, data))
            self._news.notify()
        return True

    # ---- the thread -------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            while self._take():
                pass
            self._writer.close()
        except (OSError, WriterError) as error:
            with self._news:
                self.failure = str(error)
                self._drop_all()

    def _take(self) -> bool:
        """Write what waits; False when there is nothing and will be nothing."""
        with self._news:
            while not self._queue and not self._ended:
                self._news.wait()
            self._batch, self._queue = self._queue, deque()
        while self._batch:
            self._write(self._batch[0])
            self._batch.popleft()
        return bool(self._queue) or not self._ended

    def _write(self, item: Topic | tuple[str, int, bytes]) -> None:
        if isinstance(item, Topic):
            self._connections[item.name] = self._writer.add_connection(
                item.name, item.kind, msgdef=item.definition, rihs01=item.digest,
                offered_qos_profiles=[offered_qos(offer) for offer in item.offers],
            )  # fmt: skip
            return
        name, stamp, data = item
        self._writer.write(self._connections[name], stamp, data)
        self.written[name] += 1
        with self._news:
            self._waiting -= len(data)

    def _drop_all(self) -> None:
        for item in (*self._batch, *self._queue):
            if not isinstance(item, Topic):
                self.dropped[item[0]] += 1
        self._batch.clear()
        self._queue.clear()
