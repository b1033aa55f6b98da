"""What waits to be sent to one client, and how it may be cut."""


class Outbox:
    """Packages go out as they are, split, or several at once.

    Attributes:
        split_at: Bytes of the last package that go out at once; the rest goes with the next
            cycle. 0: all of it.
        coalesce: Number of packages that are kept back and then sent together; 1: none.
    """

    def __init__(self) -> None:
        self.split_at, self.coalesce = 0, 1
        self._kept: list[bytes] = []
        self._rest = b""

    def put(self, package: bytes) -> None:
        """Have a package sent; nothing if it is empty."""
        if package:
            self._kept.append(package)

    def take(self) -> bytes:
        """Bytes to be sent now; called once a cycle."""
        now, self._rest = self._rest, b""
        if not self._kept or len(self._kept) < self.coalesce:
            return now
        packages, self._kept = self._kept, []
        last = packages.pop()
        cut = self.split_at or len(last)
        self._rest = last[cut:]
        return now + b"".join(packages) + last[:cut]
