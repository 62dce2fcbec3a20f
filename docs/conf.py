"""How the pages are built: `make docs`. Notebooks among them are run, at small sizes, and a warning is an error."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import myst_nb.core.render

import jaxnh

# Commands in notebooks are those of this environment, and find the package of this repository.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
os.environ["PYTHONPATH"] = str(Path(__file__).parents[1])
os.environ["COLUMNS"] = "110"
os.environ["TTY_COMPATIBLE"] = "0"  # a kernel asks rich for colours, whose codes a page cannot show
os.environ["_TYPER_FORCE_DISABLE_TERMINAL"] = "1"

project = "jaxnh"
author = "jaxnh contributors"
copyright = author
release = version = jaxnh.__version__
html_title = f"jaxnh {version}"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
html_theme = "alabaster"
html_theme_options = {"page_width": "1100px", "sidebar_width": "240px", "fixed_sidebar": True}
html_show_sourcelink = False

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4

nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_show_tb = True
nb_execution_timeout = 300
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
default_role = "literal"

nitpicky = True
# Types of other packages have no page here, and of our own those of `jaxnh` itself and its exceptions.
nitpick_ignore_regex = [("py:.*", r"(?!jaxnh\.).*"), ("py:.*", r"jaxnh\.(?!exceptions\.)\w+\..*")]


def _joined(outputs: list[dict]) -> list[dict]:
    """Pieces of what a cell has printed as one text, as they came; myst-nb's own function ends each with a line.

    A cell of a shell's commands hands on what they print a hundred characters at a time.
    """
    found: list[dict] = []
    streams: dict[str, dict] = {}
    for output in outputs:
        if output["output_type"] == "stream" and output["name"] in streams:
            streams[output["name"]]["text"] += output["text"]
            continue
        if output["output_type"] == "stream":
            streams[output["name"]] = output
        found.append(output)
    return found


myst_nb.core.render.coalesce_streams = _joined
