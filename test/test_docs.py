# SPDX-License-Identifier: Apache-2.0
"""README and docs are true: their Python runs, their modules and links are there."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
         ROOT / "data" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def python_blocks(page):
    return re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def test_the_five_lines_of_the_readme_count_the_demo_bin():
    (code,) = python_blocks(ROOT / "README.md")
    assert len(code.splitlines()) <= 5
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "167 parts" in done.stdout


def test_every_source_file_names_its_licence():
    """All but a message of ROS's own."""
    files = [path for folder in ("stack_counter", "test", "scripts", "launch", "msg_defs")
             for path in (ROOT / folder).rglob("*") if path.suffix in (
                 ".py", ".sh", ".msg", ".srv", ".action", ".cmake")
             and path.name != "TFMessage.msg"]
    assert len(files) > 200
    for path in [*files, ROOT / "setup.py", ROOT / "Makefile", ROOT / ".ci" / "run"]:
        head = path.read_text().splitlines()[:2]
        assert "# SPDX-License-Identifier: Apache-2.0" in head, path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_import_line_runs(page):
    lines = [line for block in python_blocks(page) for line in block.splitlines()
             if re.match(r"(from|import) ", line)]
    for line in lines:
        exec(compile(line, str(page), "exec"), {})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_and_file_that_is_named_exists(page):
    text = page.read_text()
    for name in re.findall(r"python -m (stack_counter[\w.]*)", text):
        assert importlib.util.find_spec(name), name
    for path in re.findall(r"`(stack_counter/[\w/]+\.\w+)`", text):
        assert (ROOT / path).is_file(), path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target
