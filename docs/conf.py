"""The site of the documentation, for Sphinx: ./koop docs makes it in docs_site."""

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

DOCS = Path(__file__).parent
ROOT = DOCS.parent
project = "koop"
author = "the koop maintainers"
root_doc = "README"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["study"]
html_extra_path = ["study"]
html_theme = "furo"
html_title = "koop"
myst_heading_anchors = 3
napoleon_google_docstring = False
napoleon_use_ivar = True
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "description"
linkcheck_timeout = 10

PAGES = {
    "Tutorials": "first-loop commission-a-rig",
    "How-to": "connect-a-rig one-sensor replay-and-inspect use-the-page run-as-a-service real-time "
    "two-hosts secure-a-loop add-a-scenario",
    "Reference": "commands parameters messages files diagnostics exit-codes glossary api",
    "Explanation": "theory adaptive-law tuning study decisions/README",
}
PUBLIC = {
    "koop_esc": "estimator online",
    "koopman_lifter": "observables edmd modes model delays contrast cost",
    "relay_esc": "config relay swing directions",
    "koop_loop": "loop metrics training",
    "koop_bag": "bag.reader bag.columns bag.writer",
    "koop_identify": "model.from_bags",
    "koop_tune": "excitation.static_map search.run",
}


def adapt(app: Sphinx, name: str, source: list[str]) -> None:
    """Put in what stands elsewhere, and turn links to files that the site does not hold into names.

    The site begins with the README; the page of the Python packages is made of the wheel's README
    and docstrings.
    """
    folder = (DOCS / name).parent
    text = source[0]
    if name == "README":
        text = (ROOT / "README.md").read_text().replace("](docs/", "](")
        for part, pages in PAGES.items():
            lines = [f"{part.lower()}/{page}" for page in pages.split()]
            text += "\n".join([f"\n```{{toctree}}\n:caption: {part}\n:hidden:\n", *lines, "```\n"])
    elif name == "reference/api":
        text = (ROOT / "python/README.md").read_text().replace("# koop-esc", "# Python API", 1)
        for package, modules in PUBLIC.items():
            for module in (f"{package}.{name}" for name in modules.split()):
                text += f"\n## {module}\n\n```{{eval-rst}}\n.. automodule:: {module}\n```\n"
    elif name == "explanation/decisions/README":
        text += "\n```{toctree}\n:hidden:\n:glob:\n\n0*\n```\n"

    def kept(link: re.Match[str]) -> str:
        target = (folder / link[2].partition("#")[0]).resolve()
        held = target.is_relative_to(DOCS) and target.is_file()
        return link[0] if held else link[1]

    source[0] = re.sub(r"(?<!!)\[([^]]*)\]\((?!\w+:)([^)\s]+)\)", kept, text)


def escape(*details: Any) -> None:
    """Keep the mathematics of docstrings from being read as markup."""
    lines: list[str] = details[-1]
    lines[:] = [re.sub(r"(?<!`)([|*])(?!`)", r"\\\1", line) for line in lines]


def setup(app: Sphinx) -> None:
    """Connect them."""
    app.connect("autodoc-process-docstring", escape, priority=1)
    app.connect("source-read", adapt)
