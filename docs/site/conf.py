"""Settings of Sphinx for the pages that ``build_site.py`` lays out."""

import os
import sys
import tomllib
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import docstrings

ROOT = Path(os.environ["PLENOPIV_ROOT"])

project = "PlenoPIV"
author = copyright = "The PlenoPIV developers"
release = version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
source_suffix = {".md": "myst-nb"}
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_dmath_double_inline = True

nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / "site" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_execution_in_temp = True

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "ignore-module-all": True}
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_mock_imports = ["dask", "distributed", "jax", "lvpyio", "psutil"]  # extras
add_module_names = False
python_maximum_signature_line_length = 90
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"PlenoPIV {release}"
html_static_path = [str(ROOT / "build" / "site" / "source" / "_static")]
html_css_files = ["site.css"]
html_extra_path = [str(ROOT / "build" / "site" / "source" / "_extra")]
html_show_search_summary = False  # pages that are files cannot fetch one another
html_copy_source = html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
pygments_style, pygments_dark_style = "friendly", "native"
templates_path = []
exclude_patterns = ["_extra"]
suppress_warnings = ["ref.python"]  # a short name in an annotation that two modules have: no link of ours
nitpicky = False  # annotations name NumPy's and xarray's types, whose inventories are on the network


def setup(app: Any) -> None:
    """Docstrings are read by way of ``docstrings``."""
    app.connect("autodoc-process-docstring", docstrings.process, priority=400)
