# SPDX-License-Identifier: Apache-2.0
"""Finds the bags of an archive: below a folder, or named in a list."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from stack_counter.bag.bag_paths import EXPECTED, METADATA, find_recordings, is_recording
from stack_counter.errors import BagError, ConfigError


def find_bags(path: Path) -> list[Path]:
    """Absolute paths of all bags below a folder, or of those in a list, each once.

    Args:
        path: a folder; a bag; or a text file with a path a line, from the file's own folder on,
            where empty lines and those that begin with # are left out.

    Raises:
        FileNotFoundError: there is no such path.
        ConfigError: there is no bag, or the file is no text.
    """
    if not path.exists():
        raise FileNotFoundError(f"no archive {path}; expected a folder with bags, or a list of "
                                "their paths")
    path = path.absolute()
    if path.is_dir():
        bags = sorted(_bags_below(path))
    elif is_recording(path):
        bags = [path]
    else:
        bags = _listed_bags(path)
    if not bags:
        raise ConfigError(f"no bag in {path}; {EXPECTED} in it")
    return list(dict.fromkeys(bags))


def _bags_below(folder: Path) -> Iterator[Path]:
    """Bags of a folder and of those below it; what lies in a bag is no other."""
    for name, folders, files in os.walk(folder):
        here = Path(name)
        if METADATA in files:
            folders.clear()
            yield here
            continue
        recordings = [here / file for file in files if is_recording(here / file)]
        yield from [here] if _is_split_bag(here, recordings) else recordings


def _is_split_bag(folder: Path, recordings: list[Path]) -> bool:
    """Whether several files are one bag whose recorder has left no metadata."""
    if len(recordings) < 2:
        return False
    try:
        return len(find_recordings(folder)) == len(recordings)
    except BagError:
        return False


def _listed_bags(path: Path) -> list[Path]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is no text; expected a folder with bags, or a list of their "
                          "paths") from error
    return [path.parent / line.strip() for line in lines
            if line.strip() and not line.lstrip().startswith("#")]
