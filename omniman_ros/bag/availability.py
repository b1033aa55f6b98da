"""Whether the library of recordings is here; asked before anything else is imported."""

from importlib.util import find_spec

HINT = "recordings need rosbags: pip install 'omniman_ros[record]', or pip install rosbags"


def is_available() -> bool:
    """Whether rosbags is installed."""
    return find_spec("rosbags") is not None
