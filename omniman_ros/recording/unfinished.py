"""MCAP files whose writer was killed: all complete records, without index and end.

The format is that of https://mcap.dev/spec: magic bytes, then records of an opcode, a length and
the content, and magic bytes again.
"""

import shutil
import struct
from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"  #: First and last bytes of a complete file
_HEAD = struct.Struct("<BQ")  #: Opcode and length of a record
#: End of the data and footer, both without a checksum, and without a summary
_END = _HEAD.pack(0x0F, 4) + bytes(4) + _HEAD.pack(0x02, 20) + bytes(20) + MAGIC


def is_unfinished(file: Path) -> bool:
    """Return whether a file begins as an MCAP file and does not end as one.

    Raises:
        OSError: The file cannot be read.
    """
    with file.open("rb") as data:
        begin = data.read(len(MAGIC))
        data.seek(-len(begin), 2)
        return begin == MAGIC and (data.tell() == 0 or data.read() != MAGIC)


def finish_copy(file: Path, target: Path) -> None:
    """Copy an unfinished file up to its last complete record, and finish the copy.

    Raises:
        OSError: The file cannot be read, or the copy cannot be written.
    """
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
