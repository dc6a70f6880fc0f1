"""The configuration of Sphinx; build.py lays the pages out that it reads."""

from pathlib import Path

project = "qdgrasp"
copyright = "The qdgrasp developers"  # noqa: A001  # Sphinx reads this name
language = "en"

extensions = ["myst_parser"]
root_doc = "index"
nitpicky = False

myst_heading_anchors = 5
myst_enable_extensions = ["colon_fence"]
myst_linkify_fuzzy_links = False

default_role = "py:obj"  # docstrings write names in single backticks; what is no object becomes plain code
add_module_names = False
toc_object_entries_show_parents = "hide"
python_maximum_signature_line_length = 88
suppress_warnings = [
    "ref.python",  # a short name in a docstring may be that of two classes
    "misc.highlighting_failure",  # TOML and JSON with remarks, which their lexers refuse
]

html_theme = "furo"
html_title = "qdgrasp"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_search_scorer = str(Path(__file__).with_name("scorer.js"))
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
