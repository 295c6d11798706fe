# SPDX-License-Identifier: Apache-2.0
"""Decompositions kept on disk, in the user's cache folder; deleting it costs time only."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
import zlib
from pathlib import Path

import numpy as np

from stack_counter.files import user_cache_folder


def cache_key(vertices: np.ndarray, faces: np.ndarray, made_by: object) -> str:
    """A name that only the same mesh, cut by the same settings and libraries, has."""
    digest = hashlib.sha256(repr(made_by).encode())
    for array in (vertices, faces):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def load_pieces(key: str) -> list[np.ndarray] | None:
    """Corners (n, 3) float64 of the pieces that were stored so; None if there are none."""
    try:
        with np.load(_path(key), allow_pickle=False) as file:
            corners, counts = file["corners"], file["counts"]
            if corners.shape != (counts.sum(), 3) or not np.isfinite(corners).all():
                return None
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error):
        return None  # not there, or damaged: it is made again
    return np.split(corners, np.cumsum(counts)[:-1])


def store_pieces(key: str, pieces: list[np.ndarray]) -> None:
    """Stores pieces in one step: whoever reads meanwhile finds all of them or none.

    Where the folder cannot be written nothing is stored, and they are made again next time.
    """
    path = _path(key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            unfinished = Path(folder) / path.name
            np.savez_compressed(unfinished, corners=np.vstack(pieces),
                                counts=np.array([len(corners) for corners in pieces]))
            os.replace(unfinished, path)
    except OSError:
        return


def _path(key: str) -> Path:
    """Two levels: one folder never holds thousands of files."""
    return user_cache_folder() / "pieces" / key[:2] / f"{key}.npz"
