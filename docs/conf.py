"""The documentation site, for Sphinx and for rosdoc2: pages in Markdown, the reference made from the code.

rosdoc2 copies this folder elsewhere, runs this file in the copy, and has the package on the import path.
"""

import importlib.util
import sys
from pathlib import Path
from xml.etree import ElementTree

HERE = Path.cwd()  # Sphinx reads the file from its own folder
sys.path[:0] = [str(HERE.parent), str(HERE)]

from generated import write_reference  # noqa: E402

import squeal_rig  # noqa: E402

ROOT = Path(squeal_rig.__file__).parents[1]

project = "squeal_rig"
author = copyright = "The squeal_rig authors"  # noqa: A001
release = version = ElementTree.parse(ROOT / "package.xml").getroot().findtext("version") or ""


def _installed(name: str) -> bool:
    return importlib.util.find_spec(name) is not None


# rosdoc2 knows no myst-nb and removes it: the notebooks are left out then.
_notebooks = _installed("myst_nb") and HERE.parent == ROOT
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_nb" if _notebooks else "myst_parser",
]
nb_execution_mode = "force"  # none of what they print and draw is kept in the repository
nb_execution_raise_on_error = True
nb_execution_timeout = 600
exclude_patterns = ["_build", "evidence", "**.ipynb_checkpoints", *([] if _notebooks else ["notebooks"])]
suppress_warnings = ["myst.header", "toc.empty_glob", *([] if _notebooks else ["toc.not_readable", "toc.excluded"])]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
napoleon_google_docstring = True
html_theme = "furo" if _installed("furo") else "alabaster"
html_title = f"squeal_rig {release}"
html_show_sourcelink = False

write_reference(HERE / "reference")


def _as_restructured_text(
    _app: object, _what: str, _name: str, _of: object, _options: object, lines: list[str]
) -> None:
    """Docstrings are plain text: an absolute value is no substitution, and a list may end without an empty line."""
    lines[:] = [line.replace("|", r"\|") for line in lines]
    for number in range(len(lines) - 1, 0, -1):
        before, line = lines[number - 1], lines[number]
        in_list = before.startswith(("- ", "  ")) and before.strip()
        if in_list and line.strip() and not line.startswith(("- ", " ")):
            lines.insert(number, "")


def setup(app):  # noqa: ANN001, ANN201
    app.connect("autodoc-process-docstring", _as_restructured_text)
