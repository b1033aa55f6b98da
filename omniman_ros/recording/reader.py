"""Reading of rosbag2 recordings, MCAP or SQLite, with the definitions that they contain."""

import shutil
import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from omniman_ros.core.errors import FileError, InputError
from omniman_ros.yaml_files import read_yaml

_DAMAGE_ERRORS = (
    AnyReaderError,
    ReaderError,
    SerdeError,
    LookupError,
    ValueError,
    OverflowError,
    MemoryError,
    struct.error,
)  #: Exceptions of the library for a damaged file; it trusts any length that it reads
_METADATA = "metadata.yaml"  #: File beside those of a recording, with its topics
_INFORMATION = "rosbag2_bagfile_information"  #: Key below which that file has its content
#: Number of bytes that Fast CDR may append: it aligns to 8 bytes where the numbers of a last,
#: empty sequence would begin, and the library expects nothing there. They have any value.
_ALIGNMENT = 4
MAGIC = b"\x89MCAP0\r\n"  #: First and last bytes of a complete file
_HEAD = struct.Struct("<BQ")  #: Opcode and length of a record, https://mcap.dev/spec
#: End of the data and footer, both without a checksum, and without a summary
_END = _HEAD.pack(0x0F, 4) + bytes(4) + _HEAD.pack(0x02, 20) + bytes(20) + MAGIC


def is_unfinished(file: Path) -> bool:
    """Return whether a file begins as an MCAP file and does not end as one."""
    with file.open("rb") as data:
        begin = data.read(len(MAGIC))
        data.seek(-len(begin), 2)
        return begin == MAGIC and (data.tell() == 0 or data.read() != MAGIC)


def finish_copy(file: Path, target: Path) -> None:
    """Copy an unfinished file up to its last complete record, and finish the copy."""
    shutil.copyfile(file, target)
    with target.open("r+b") as copy:
        size = copy.seek(0, 2)
        end = len(MAGIC)
        while end + _HEAD.size <= size:
            copy.seek(end)
            _, length = _HEAD.unpack(copy.read(_HEAD.size))
            if length > size - end - _HEAD.size:
                break
            end += _HEAD.size + length
        copy.seek(end)
        copy.truncate()
        copy.write(_END)


class BagReader:
    """Reader of a recording, as a context manager.

    A recording whose process was killed is read up to the last complete record on the disk, from a
    temporary copy.

    Args:
        path: Folder of the recording, or its only file.

    Attributes:
        topic_types: Message type of each topic that has messages.

    Raises:
        InputError: There is no recording at the path, or it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._copies = ExitStack()
        try:
            _check_metadata(path / _METADATA)
            unfinished = _unfinished_file(path)
            self.is_unfinished = unfinished is not None
            if unfinished is not None:
                path = Path(self._copies.enter_context(TemporaryDirectory())) / unfinished.name
                finish_copy(unfinished, path)
            # SQLite recordings of older releases contain no definitions.
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        except (AnyReaderError, FileError, OSError) as error:
            self._copies.close()
            raise InputError(f"{self._path} is not a recording: {error}") from error
        self.topic_types: dict[str, str] = {}

    def __enter__(self) -> Self:
        try:
            self._reader.open()
        except _DAMAGE_ERRORS as error:
            self._copies.close()
            reason = " ".join(str(error).split())
            raise InputError(f"{self._path} cannot be read: {reason}") from error
        self.topic_types = {c.topic: c.msgtype for c in self._reader.connections if c.msgcount}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()
        self._copies.close()

    @property
    def duration(self) -> float:
        """Time from the first message to the last [s]."""
        return self._reader.duration * 1e-9

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, float, Any]]:
        """Yield the messages of some topics in the order of their arrival.

        Each comes with its topic and its time of arrival [s].

        Raises:
            InputError: The recording is damaged.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics and c.msgcount]
        if not chosen:
            return
        try:
            for connection, stamp, data in self._reader.messages(chosen):
                yield connection.topic, stamp * 1e-9, self._message(data, connection.msgtype)
        except _DAMAGE_ERRORS as error:
            raise InputError(f"{self._path} is damaged: {error}") from error

    def _message(self, data: bytes, message_type: str) -> Any:
        try:
            return self._reader.deserialize(data, message_type)
        except AnyReaderError:
            return self._reader.deserialize(data[:-_ALIGNMENT], message_type)


def _check_metadata(file: Path) -> None:
    if not file.is_file():
        return
    tree = read_yaml(file)
    if not isinstance(tree, Mapping) or not isinstance(tree.get(_INFORMATION), Mapping):
        raise FileError(str(file), None, f"has no '{_INFORMATION}:' with values")


def _unfinished_file(path: Path) -> Path | None:
    """Return the file of a recording whose process was killed, or None."""
    if path.is_dir() and not (path / _METADATA).exists():
        files = sorted(path.glob("*.mcap"))
    else:
        files = [path] if path.suffix == ".mcap" else []
    return files[0] if len(files) == 1 and is_unfinished(files[0]) else None
