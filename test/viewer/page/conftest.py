"""The tests of the page need viser, which is optional (extra `viewer`)."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("viser") else ["test_*.py"]
