"""Where the shipped configuration files are, and how such files are written."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from stack_counter.errors import ConfigError


def config_path(name: str) -> Path:
    """Path of a file of `config/`.

    Raises:
        ConfigError: it is nowhere.
    """
    # A checkout (or an editable install) first, then what setup.py installs: below an ament
    # prefix in a colcon workspace, below sys.prefix otherwise.
    folders = [Path(__file__).parents[1] / "config"]
    folders += [Path(prefix) / "share" / "stack_counter" / "config" for prefix in
                (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix) if prefix]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise ConfigError(f"no {name} in {[str(f) for f in folders]}; expected it in one of them")


def write_atomically(path: Path, text: str) -> None:
    """Writes a file; whoever reads meanwhile finds the old text or the new. Raises OSError."""
    half = path.with_suffix(".part")
    half.write_text(text)
    half.replace(path)
