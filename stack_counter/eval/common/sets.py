"""Sets of simulated scenes by name."""

from __future__ import annotations

from pathlib import Path

from stack_counter.errors import ConfigError


def folder_of(name: str) -> Path:
    """The folder of a set: as named, or below `data`.

    Raises:
        ConfigError: neither is there.
    """
    for path in (Path(name), Path("data") / name):
        if path.is_dir():
            return path
    raise ConfigError(f"no set '{name}'; expected unseen, unseen-mixed or a folder of scenes")
