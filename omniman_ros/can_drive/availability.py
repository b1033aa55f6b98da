"""Whether the libraries of the bus are here; asked before anything else is imported."""

from importlib.util import find_spec

HINT = "drives on a CAN bus need python-can and canopen: pip install python-can canopen"


def is_available() -> bool:
    """Whether both are installed."""
    return find_spec("can") is not None and find_spec("canopen") is not None
