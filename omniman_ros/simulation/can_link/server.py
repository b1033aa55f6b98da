"""The drives' end of the stream: it listens, and serves one host at a time."""

from collections.abc import Iterable

from omniman_ros.simulation.can_link.records import Record, RecordReader, encode
from omniman_ros.simulation.link_server import LinkServer


class CanLinkServer(LinkServer[Record, Iterable[Record]]):
    """Exchanges records at a port; a ParameterError says that it is not available."""

    def __init__(self, port: int) -> None:
        super().__init__("bus_port", port, RecordReader, _encode_all)


def _encode_all(records: Iterable[Record]) -> bytes:
    return b"".join(map(encode, records))
