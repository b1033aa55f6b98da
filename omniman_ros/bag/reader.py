"""Reads rosbag2 recordings, MCAP or SQLite, with the definitions that they carry."""

import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from omniman_ros.core.errors import InputError

_DAMAGED = (
    AnyReaderError, ReaderError, SerdeError, LookupError, ValueError, OverflowError, MemoryError,
    struct.error,
)  # fmt: skip
"""What the library raises where a file is damaged: it takes any length for true."""


class BagReader:
    """A recording, as a context manager.

    Args:
        path: Its folder, or its one file.

    Attributes:
        kinds: Type of each topic that has messages.

    Raises:
        InputError: It is not there, or no recording that can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            # SQLite recordings of older releases carry no definitions.
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        except (AnyReaderError, FileNotFoundError) as error:
            raise InputError(f"{path} is no recording: {error}") from error
        self.kinds: dict[str, str] = {}

    def __enter__(self) -> Self:
        try:
            self._reader.open()
        except _DAMAGED as error:
            raise InputError(f"{self._path} cannot be read: {error}") from error
        self.kinds = {c.topic: c.msgtype for c in self._reader.connections if c.msgcount}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._reader.close()

    @property
    def duration(self) -> float:
        """From the first message to the last [s]."""
        return self._reader.duration * 1e-9

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, float, Any]]:
        """Topic, time of arrival [s] and message, in the order of arrival.

        Raises:
            InputError: The recording is damaged.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics and c.msgcount]
        if not chosen:
            return
        try:
            for connection, stamp, data in self._reader.messages(chosen):
                message = self._reader.deserialize(data, connection.msgtype)
                yield connection.topic, stamp * 1e-9, message
        except _DAMAGED as error:
            raise InputError(f"{self._path} is damaged: {error}") from error
