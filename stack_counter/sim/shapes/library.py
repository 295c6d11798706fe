# SPDX-License-Identifier: Apache-2.0
"""Shapes from a file, read one at a time.

Parts of our own making, such as `data/unseen/shapes.npz`, are one npz. A collection of solids that
others have made is an npz with an index beside it, which states the origin of each:
`sim/shapes/extra/collection.py` describes it. Families of those are named SOURCE/FAMILY.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, overload

import numpy as np

from stack_counter.sim.shapes import SIZES_M
from stack_counter.sim.shapes.shape import Shape, ShapeError, shape_from_mesh


@dataclass(frozen=True, eq=False)
class Library(Sequence[Shape]):
    """Shapes of a file; each is made and checked when it is asked for, `seed` is its position.

    Processes that get one read the file themselves.

    Attributes:
        path: the npz.
        families: name of each shape's family, behind `SOURCE/` in a collection.
        vertices: (v, 3) of all shapes one after the other, in units of `scale`.
        faces: (f, 3) indices, those of each shape from 0.
        vertex_offsets, face_offsets: (n + 1,) where each shape begins.
        scale: metres of a unit, for each shape.
        credits: number of shapes by "source, licence" of a collection; empty for our own parts.
    """

    path: Path
    families: tuple[str, ...]
    vertices: np.ndarray
    faces: np.ndarray
    vertex_offsets: np.ndarray
    face_offsets: np.ndarray
    scale: np.ndarray
    credits: dict[str, int]

    def __len__(self) -> int:
        return len(self.families)

    @overload
    def __getitem__(self, place: int) -> Shape: ...
    @overload
    def __getitem__(self, place: slice) -> list[Shape]: ...

    def __getitem__(self, place: int | slice) -> Shape | list[Shape]:
        if isinstance(place, slice):
            return [self[i] for i in range(*place.indices(len(self)))]
        if not 0 <= place < len(self):
            raise IndexError(f"shape {place} of {self.path}; expected 0 to {len(self) - 1}")
        vertices = self.vertices[self.vertex_offsets[place]:self.vertex_offsets[place + 1]]
        faces = self.faces[self.face_offsets[place]:self.face_offsets[place + 1]]
        return shape_from_mesh(vertices * self.scale[place], faces.astype(np.int32),
                               self.families[place], place)

    def __reduce__(self) -> tuple[Callable[[Path], Library], tuple[Path]]:
        return open_library, (self.path,)


def open_library(path: str | Path) -> Library:
    """Opens a file of shapes, which is read once by a process as long as it stays the same.

    Args:
        path: npz that `save_shapes` wrote, with `families` (n,) str, `vertex_offsets`,
            `face_offsets` (n + 1,) int64, `vertices` (v, 3) float32, metres, and `faces` (f, 3)
            int32; or a collection that `write_collection` wrote, its index beside it.

    Raises:
        ShapeError: the file is missing or damaged.
    """
    try:
        whole = Path(path).resolve(strict=True)
        return _read_library(whole, whole.stat().st_mtime_ns)
    except (OSError, EOFError, KeyError, ValueError, TypeError, IndexError,
            zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).partition("\n")[0]
        raise ShapeError(f"{path}: {reason}; expected an npz of shapes") from error


@lru_cache(maxsize=2)
def _read_library(path: Path, _changed_ns: int) -> Library:
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    library = _read_collection(path, arrays) if "voff" in arrays else Library(
        path, tuple(arrays["families"].tolist()), arrays["vertices"], arrays["faces"],
        arrays["vertex_offsets"], arrays["face_offsets"],
        np.ones(len(arrays["families"])), {})
    for name, offsets, items in (("vertices", library.vertex_offsets, library.vertices),
                                 ("faces", library.face_offsets, library.faces)):
        if offsets.shape != (len(library) + 1,) or offsets[-1] != len(items):
            raise ValueError(f"{offsets.shape} offsets of {len(library)} shapes for {len(items)} "
                             f"{name}; expected {len(library) + 1} up to their number")
    return library


def _read_collection(path: Path, arrays: dict[str, np.ndarray]) -> Library:
    """A collection; solids of unknown size, or of none that we simulate, get one as ours do."""
    index = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["shapes"]
    if [entry["id"] for entry in index] != arrays["ids"].tolist():
        raise ValueError(f"{path.with_suffix('.json').name} beside it lists other shapes")
    drawn = np.random.default_rng(0).uniform(*SIZES_M, len(index))
    known = arrays["size_mm"].astype(float) / 1000  # NaN: unknown
    sizes = np.where((known >= SIZES_M[0]) & (known <= SIZES_M[1]), known, drawn)
    return Library(path, tuple(f"{entry['source']}/{entry['family']}" for entry in index),
                   arrays["verts"], arrays["faces"], arrays["voff"], arrays["foff"],
                   sizes * float(arrays["scale"]),
                   dict(Counter(f"{entry['source']}, {entry['licence']}" for entry in index)))


def source_of(family: str) -> str:
    """The source of a collection that a family's name begins with; "" for our own parts."""
    return family.rpartition("/")[0]


def load_shapes(path: str | Path) -> list[Shape]:
    """Reads and checks every shape of a file.

    Raises:
        ShapeError: the file is missing or damaged, or a mesh is not one watertight body.
    """
    return list(open_library(path))


def save_shapes(path: str | Path, shapes: list[Shape], **extra: Any) -> None:
    """Writes shapes as `open_library` reads them, behind further arrays of the caller's."""
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
