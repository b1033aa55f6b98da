"""The tests of the page need viser, which is optional (extra `viewer`)."""

from importlib.util import find_spec

import pytest


class WithoutViewer(pytest.Module):
    def collect(self):
        pytest.skip("viser is not installed (extra 'viewer')")


def pytest_pycollect_makemodule(module_path, parent):
    """Skip what cannot be imported without viser, and websockets, which it brings."""
    if find_spec("viser") is None:
        return WithoutViewer.from_parent(parent, path=module_path)
    return None
