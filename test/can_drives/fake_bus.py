"""A python-can bus scripted by the test, with or without a file descriptor."""

import os
import queue

import can


class FakeBus:
    """Returns the messages put in and raises the exceptions put in; can refuse to send."""

    def __init__(self, descriptor):
        self.items = queue.Queue()
        self.sent = []
        self.refusal = None
        self.said = can.BusState.ACTIVE
        self.endless = None
        self.closed = False
        self._pipe = os.pipe() if descriptor else None

    def put(self, *items):
        for item in items:
            self.items.put(item)
            if self._pipe:
                os.write(self._pipe[1], b".")

    def fileno(self):
        if self._pipe is None:
            raise NotImplementedError
        return self._pipe[0]

    def recv(self, timeout):
        if self.endless is not None:
            item = self.endless
        else:
            try:
                item = self.items.get(timeout=timeout) if timeout else self.items.get_nowait()
            except queue.Empty:
                return None
            if self._pipe:
                os.read(self._pipe[0], 1)
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, message):
        error = self.refusal(message) if self.refusal is not None else None
        if error is not None:
            raise error
        self.sent.append(message)

    @property
    def state(self):
        if isinstance(self.said, Exception):
            raise self.said
        return self.said

    def shutdown(self):
        self.closed = True
        for end in self._pipe or ():
            os.close(end)


def message(identity=0x181, data=b"abc", **fields):
    """Return a message of python-can."""
    fields = {"is_extended_id": False} | fields
    return can.Message(arbitration_id=identity, data=data, **fields)


def caused(error, cause):
    """Return an error with a cause."""
    error.__cause__ = cause
    return error
