# SPDX-License-Identifier: Apache-2.0
"""Shapes from a file, such as the unseen test set `data/unseen/shapes.npz`."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.sim.shapes.shape import Shape, ShapeError, shape_from_mesh


def save_shapes(path: str | Path, shapes: list[Shape], **extra: Any) -> None:
    """Writes shapes as `load_shapes` reads them, behind further arrays of the caller's."""
    np.savez_compressed(
        path, **extra, families=np.array([s.family for s in shapes]),
        vertex_offsets=np.cumsum([0] + [len(s.vertices) for s in shapes], dtype=np.int64),
        face_offsets=np.cumsum([0] + [len(s.faces) for s in shapes], dtype=np.int64),
        vertices=np.concatenate([s.vertices for s in shapes]).astype(np.float32),
        faces=np.concatenate([s.faces for s in shapes]).astype(np.int32))


def write_library(out: Path, make_checked: Callable[[str, int], Shape],
                  families: Iterable[str], variants: range) -> None:
    """Writes all parts that `make_checked` makes, and prints which of them it refuses.

    It is called with each family and variant.
    """
    shapes, refused = [], 0
    for family in families:
        for variant in variants:
            try:
                shapes.append(make_checked(family, variant))
            except ShapeError as error:
                refused += 1
                print(f"refused {family} {variant}: {error}")
    out.parent.mkdir(parents=True, exist_ok=True)
    save_shapes(out, shapes)
    print(f"{len(shapes)} shapes, {refused} refused, {out.stat().st_size / 1e6:.2f} MB")


def load_shapes(path: str | Path) -> list[Shape]:
    """Reads and checks every shape of a file that `save_shapes` wrote.

    Args:
        path: npz with `families` (n,) str, `vertex_offsets`, `face_offsets` (n + 1,)
            int64, `vertices` (v, 3) float32, metres, and `faces` (f, 3) int32.

    Returns:
        The shapes; `family` is the family's name, `seed` the position in the file.

    Raises:
        ShapeError: the file is missing or damaged, or a mesh is not one watertight body.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            families, vertices, faces = (file[k] for k in ("families", "vertices", "faces"))
            cuts = [file[k][1:-1] for k in ("vertex_offsets", "face_offsets")]
        parts = zip(families, np.split(vertices, cuts[0]), np.split(faces, cuts[1]), strict=True)
        return [shape_from_mesh(v, f, str(family), i) for i, (family, v, f) in enumerate(parts)]
    except (OSError, EOFError, KeyError, ValueError, TypeError, IndexError,
            zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).partition("\n")[0]
        raise ShapeError(f"{path}: {reason}; expected an npz of shapes") from error
