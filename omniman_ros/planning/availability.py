"""Whether the solver's library is here; asked before anything else is imported."""

from importlib.util import find_spec

HINT = "the planner needs casadi: pip install casadi"


def is_available() -> bool:
    """Whether casadi is installed."""
    return find_spec("casadi") is not None
