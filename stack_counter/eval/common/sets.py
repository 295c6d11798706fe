# SPDX-License-Identifier: Apache-2.0
"""Sets of simulated scenes by name."""

from __future__ import annotations

from pathlib import Path

from stack_counter.errors import ConfigError
from stack_counter.sim import Scene, read_scenes


def find_set_folder(name: str) -> Path:
    """The folder of a set: as named, or below `data`.

    Raises:
        ConfigError: neither is there.
    """
    for path in (Path(name), Path("data") / name):
        if path.is_dir():
            return path
    raise ConfigError(f"no set '{name}'; expected unseen, unseen-mixed or a folder of scenes")


def read_filled_scenes(name: str, limit: int | None = None) -> list[Scene]:
    """The scenes of a set that hold parts, out of all or of the first `limit`.

    Raises:
        ConfigError: no such set.
        SceneError: no shard there, or a damaged one.
    """
    return [s for s in read_scenes(find_set_folder(name), limit) if s.truth.count]
