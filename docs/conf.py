# SPDX-License-Identifier: Apache-2.0
"""The documentation site: the pages beside this file, and a reference of the package's docstrings.

`make docs` builds it into out/docs. The pages stay plain Markdown, as a repository shows it.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
from setup import VERSION  # noqa: E402 - one place has the version

project = "stack_counter"
author = copyright = "stack_counter maintainers"
release = VERSION
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"{project} {release}"
html_copy_source = False
highlight_language = "text"  # of blocks that name none: command lines and what they print
myst_heading_anchors = 4  # links to headings, as a repository makes them
# Docstrings: single backticks are code, and attributes stand in the class's own.
default_role = "literal"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "description"
napoleon_use_ivar = True
