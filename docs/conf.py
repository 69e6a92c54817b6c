"""The site of jaxact's documentation: `make docs`.

Sphinx with MyST-NB and the theme furo: pages stay the plain Markdown that is read on GitHub and
that tests run, and every code block and command in them runs when the site is built, see
`_site/cells.py`.
Jupyter Book needs the same parts and a file of its own beside them; MkDocs has no execution that
fails the build on an error; Quarto is not a Python package.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_site")]
# What cells and commands run with: the package as it is here, and the commands of this Python.
os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["COLUMNS"] = "100"

import jaxact  # noqa: E402

project = "jaxact"
author = "the jaxact developers"
release = version = jaxact.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "cells",
    "reference",
]
exclude_patterns = ["_site", "_build"]
templates_path: list[str] = []

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

# A cell that fails fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
nb_render_text_lexer = "none"

default_role = "literal"
autodoc_typehints = "description"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"jaxact {version}"
html_show_sourcelink = False
