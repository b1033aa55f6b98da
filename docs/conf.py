"""Sphinx configuration: `make docs` builds with it here, rosdoc2 for the ROS index."""

import importlib.util
import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(globals().get("__file__", "conf.py")).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))


def _is_installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


# rosdoc2 copies this folder elsewhere: the package is then where the arguments of rosdoc2 or the
# working directory point to, or it is installed.
_starts = [HERE, *map(Path, sys.argv[1:]), Path(os.environ.get("PWD", "."))]
version = ""
for _folder in (folder for start in _starts for folder in (start, *start.resolve().parents)):
    if (_folder / "omniman_ros" / "__init__.py").is_file():
        sys.path.insert(0, str(_folder.resolve()))
        (version,) = re.findall(
            "<version>(.*)</version>", (_folder / "package.xml").read_text(encoding="utf-8")
        )
        break

project = "omniman_ros"
author = "omniman_ros developers"
copyright = "omniman_ros developers, Apache-2.0"
version = release = version or installed_version(project)

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "omniman_docs",
]
if _is_installed("sphinx_copybutton"):
    extensions.append("sphinx_copybutton")
    copybutton_exclude = ".linenos, .gp, .go"

source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
# The last three are pages that rosdoc2 generates beside these.
exclude_patterns = ["_build", "results/*.json", "index.rst", "modules.rst", "omniman_ros*.rst"]
nitpicky = True
# A prime is a derivative here, not an apostrophe.
smartquotes = False
# Short type names in signatures are ambiguous between packages.
suppress_warnings = ["ref.python"]

myst_enable_extensions = ["colon_fence", "deflist", "attrs_inline", "dollarmath", "amsmath"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autoclass_content = "class"
# Docstrings put code between single backticks.
default_role = "literal"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
# Types in signatures point into other packages, which no inventory here knows.
nitpick_ignore_regex = [("py:.*", r".*")]

html_theme = "furo" if _is_installed("furo") else "sphinx_rtd_theme"
html_title = "omniman_ros"
html_static_path = ["_static"]
html_css_files = ["omniman.css"]
html_show_sourcelink = False

rosdoc2_settings = {"override_theme": html_theme != "furo"}
