"""Whether the page's library is here; asked before anything else is imported."""

from importlib.util import find_spec

HINT = "the viewer needs viser: pip install 'viser==1.1.*' websockets"


def is_available() -> bool:
    """Whether viser is installed."""
    return find_spec("viser") is not None
