# SPDX-License-Identifier: Apache-2.0
"""What a count depends on, as short texts: a bag, the settings, a part.

Of what is named by a file the content goes in, not the name: what was moved is still the same.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from stack_counter.bag.bag_paths import find_recordings
from stack_counter.config import Config
from stack_counter.files import shipped_weights
from stack_counter.parts.catalogue import Part

_DIGITS = 16  # hexadecimal, of a digest: among a million bags two are alike by chance once in 1e7
_BLOCK = 1 << 20
# Settings that no count depends on: where other things are written, and the known parts, of which
# the one that is counted has a digest of its own.
_WITHOUT_EFFECT = {"result_log", "result_log_max_mb", "report_folder", "record_folder",
                   "record_max_mb", "part_catalogue"}
# Settings that name a file or a folder; `prompts` may be their text as well.
_PATHS = {"rig", "robot_description_file", "container_catalogue", "prompts", "sam2_weights",
          "weights", "encoder_weights", "depth_weights"}


def bag_state(bag: Path) -> str:
    """Sizes and times of change of a bag's files: while these stay, so does its content.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: it is no bag.
        OSError: a file cannot be read.
    """
    stats = [path.stat() for path in find_recordings(bag)]
    return _digest(f"{stat.st_size} {stat.st_mtime_ns}" for stat in stats)


def bag_digest(bag: Path) -> str:
    """Digest of all that a bag's files hold.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: it is no bag.
        OSError: a file cannot be read.
    """
    return _digest(map(_file_digest, find_recordings(bag)))


def settings_digest(config: Config) -> str:
    """Digest of all settings that a count depends on, and of all weights.

    Raises:
        OSError: a file that they name cannot be read.
    """
    values = {f"{node}.{name}": _content(value) if name in _PATHS else repr(value)
              for node, section in vars(config).items()
              for name, value in vars(section).items() if name not in _WITHOUT_EFFECT}
    return _digest([json.dumps(values, sort_keys=True), _path_digest(shipped_weights(""))])


def with_absolute_paths(config: Config) -> Config:
    """The settings with absolute paths, which mean the same wherever they are read."""
    return replace(config, **{
        node: replace(section, **{
            name: str(Path(value).expanduser().absolute()) for name, value in vars(section).items()
            if name in (*_PATHS, "part_catalogue") and _is_path(value)})
        for node, section in vars(config).items()})


def part_digest(part: Part) -> str:
    """Digest of all that is known of a part, but its name and the note.

    Raises:
        OSError: one of its files cannot be read.
    """
    values = {field.name: _content(value) if isinstance(value, Path) else repr(value)
              for field in dataclasses.fields(part) if field.name not in ("name", "note", "mesh")
              for value in [getattr(part, field.name)]}
    return _digest([json.dumps(values, sort_keys=True)])


def result_key(bag: str, version: str, settings: str, part: str) -> str:
    """What names a result: digests of the bag, the settings and the part, and the version."""
    return _digest([bag, version, settings, part])


def _content(path: str | Path) -> str:
    """Digest of what a path holds; where there is no such path, the text itself."""
    return _path_digest(Path(path).expanduser()) if _is_path(path) else str(path)


def _is_path(text: str | Path) -> bool:
    """Whether there is such a file or folder."""
    try:
        return bool(text) and Path(text).expanduser().exists()
    except OSError:  # a text too long for a name
        return False


def _path_digest(path: Path) -> str:
    """Digest of a file, or of all files below a folder."""
    if path.is_file():
        return _file_digest(path)
    return _digest(f"{file.relative_to(path)} {_file_digest(file)}"
                   for file in sorted(path.rglob("*")) if file.is_file())


def _file_digest(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def _digest(texts: Iterable[str]) -> str:
    """Digest of several texts, none of which holds a line break."""
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:_DIGITS]
