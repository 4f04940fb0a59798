"""Settings of the documentation: `sphinx-build -W -b html docs docs/_build/html`."""

import sys
from pathlib import Path

_HERE = Path(__file__).parent
sys.path[:0] = [str(_HERE / "_ext"), str(_HERE.parent)]

from menid_plan import __version__  # noqa: E402

project = "menid-plan"
author = "the authors of menid-plan"
copyright = author  # noqa: A001
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "menid_lexer"]
exclude_patterns = ["_build", "_ext"]
source_suffix = {".md": "markdown"}

# Headings down to the fourth level can be linked to, as in diagnostics.md#m203.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"menid-plan {release}"
