"""How the documentation site is built: ``make docs``, or ``sphinx-build docs build/docs``.

The pages are Markdown that also reads well where the repository is hosted: links are relative and
may leave ``docs/``. What must not go stale is written by the code (`_extensions/generated.py`).
"""

import sys
from pathlib import Path

from pivometer import __version__

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "Pivometer"
author = "The Pivometer authors"
copyright = author  # noqa: A001 - Sphinx's name
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "accessibility",
    "generated",
    "mathml",
    "python_names",
    "repository_links",
]
exclude_patterns = ["_extensions"]
nitpicky = True
highlight_language = "none"

# --- Markdown ---

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4

# --- Python ---

default_role = "py:obj"
autodoc_default_options = {"members": True}
autodoc_typehints = "none"  # `python_names` writes them where the parameters are described
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"
add_module_names = False

# --- HTML ---

html_theme = "furo"
html_title = f"Pivometer {release}"
html_static_path = ["_static"]
html_css_files = ["pivometer.css"]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"footer_icons": []}
viewcode_line_numbers = True
