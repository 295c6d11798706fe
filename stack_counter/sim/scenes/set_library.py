# SPDX-License-Identifier: Apache-2.0
"""The library of a folder of scenes: `shapes.npz` beside the shards, or a link of that name.

Parts of our own making are copied there. A collection of others' solids stays where it is: the
folder's `run.json` names it by its digest, and whoever reads the scenes links the file.
"""

from __future__ import annotations

import json
import shutil
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.shapes.library import Library, open_library

LIBRARY_FILE = "shapes.npz"
# What the scenes of a folder are made from: an object with seed, plan, library (a digest) and,
# of a collection, credits.
RUN_FILE = "run.json"


def library_digest(path: Path) -> str:
    """What a file of shapes is named by: 16 digits of the SHA-256 of its bytes."""
    whole = path.resolve()
    return _digest(whole, whole.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _digest(path: Path, _changed_ns: int) -> str:
    return sha256(path.read_bytes()).hexdigest()[:16]


def keep_library(library: Library, folder: Path) -> None:
    """Puts a library where `find_library` looks: a copy of our own, a link to a collection."""
    place = folder / LIBRARY_FILE
    if place.resolve() == library.path:
        return
    place.unlink(missing_ok=True)
    if library.credits:
        place.symlink_to(library.path)
    else:
        shutil.copyfile(library.path, place)


def find_library(folder: Path) -> Library:
    """Opens the library that the scenes of a folder are made from.

    Raises:
        SceneError: it is not there, or another one is.
        ShapeError: it is damaged.
    """
    place, expected = folder / LIBRARY_FILE, read_run_file(folder).get("library", "")
    named = f"the file of SHA-256 {expected}..." if expected else "its file"
    advice = f"link {named}: ln -srf FILE {place}; data/README.md says where it comes from"
    if not place.exists():
        raise SceneError(f"no {place}, the shapes that the scenes are made of; {advice}")
    if expected and (digest := library_digest(place)) != expected:
        raise SceneError(f"{place} is another library, of SHA-256 {digest}...; {advice}")
    return open_library(place)


def read_run_file(folder: Path) -> dict:
    """What the scenes of a folder are made from; empty if nothing says so.

    Raises:
        SceneError: the file is damaged.
    """
    path = folder / RUN_FILE
    if not path.exists():
        return {}
    try:
        stored = json.loads(path.read_text())
    except ValueError as error:  # no JSON, or no text at all
        raise SceneError(f"{path} is damaged: {error}; expected what simulate wrote there, e.g. "
                         '{"seed": 7, "plan": "mixed", "library": ""}') from error
    if not isinstance(stored, dict):
        raise SceneError(f"{path} holds {stored!r}; expected an object with seed, plan and "
                         "library")
    return stored
