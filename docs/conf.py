"""How Sphinx builds the documentation: `make docs`."""

from importlib.metadata import version as version_of

project = "refractive-scan"
copyright = "the refractive-scan contributors"
author = "the refractive-scan contributors"
version = release = version_of("refractive-scan")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = "refractive-scan"

# Shapes such as Float64[np.ndarray, "rays 3"] are the documentation: print them as they are written.
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "exclude-members": "model_config"}
napoleon_google_docstring = False


def escape_bars(_app: object, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Keep the bars of |x| from being read as reStructuredText's substitutions."""
    lines[:] = [line if "``" in line else line.replace("|", r"\|") for line in lines]


def setup(app: object) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", escape_bars)  # type: ignore[attr-defined]  # Sphinx is untyped here
