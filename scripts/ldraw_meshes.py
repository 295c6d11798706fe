# SPDX-License-Identifier: Apache-2.0
"""Writes parts of the LDraw library as STL files, with the table that convert_shapes.py takes.

    python scripts/ldraw_meshes.py LDRAW OUT [STEP]

LDRAW is the unpacked parts library (folders `parts` and `p`); every STEP-th part is taken (default
5). Parts that state no CC BY licence, stickers and parts that have moved are left out. The table
is OUT/table.csv. The meshes are loose triangles, which convert_shapes.py closes.
"""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import numpy as np
import trimesh

from stack_counter.tasks.progress import progress

# Millimetres of LDraw's unit; names of what is no part of its own.
_MM_PER_UNIT, _NO_PARTS = 0.4, re.compile(r"[~=_|]|Sticker", re.IGNORECASE)
# LDraw's y points down.
_UPRIGHT = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def read_triangles(library: Path, name: str) -> np.ndarray:
    """(n, 3, 3) triangles of a file and all that it refers to, LDraw units.

    Raises:
        FileNotFoundError: the library lacks one of them.
    """
    name = name.replace("\\", "/").lower()
    path = library / "parts" / name
    if not path.exists():
        path = library / "p" / name
    found = [np.empty((0, 3, 3))]
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split(maxsplit=14)
        if not words or words[0] not in "134":
            continue
        if words[0] == "1":  # colour, place, 3 x 3 matrix, file
            values = np.array(words[2:14], float)
            found.append(read_triangles(library, words[14].strip())
                         @ values[3:].reshape(3, 3).T + values[:3])
        else:  # colour, three or four corners
            corners = np.array(words[2:2 + 3 * int(words[0])], float).reshape(-1, 3)
            found += [corners[[0, i, i + 1]][None] for i in range(1, len(corners) - 1)]
    return np.concatenate(found)


def read_header(path: Path) -> dict[str, str] | None:
    """Family, author and licence of a part; None if it is left out."""
    text = path.read_text(encoding="utf-8", errors="replace")
    title = text.splitlines()[0].removeprefix("0").strip() if text else ""
    licence = re.search(r"!LICENSE.*(CC BY [\d.]+)", text)
    author = re.search(r"^0 Author: (.*)$", text, re.MULTILINE)
    if not title or _NO_PARTS.match(title) or licence is None:
        return None
    return {"source": "LDraw", "licence": licence[1], "family": title.split()[0],
            "author": author[1].strip() if author else "", "mm_per_unit": str(_MM_PER_UNIT)}


def main(library: Path, out: Path, step: int = 5) -> None:
    """Writes the meshes and the table."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for path in progress(sorted((library / "parts").glob("*.dat"))[::step], "LDraw", "parts"):
        if header := read_header(path):
            try:
                corners = (read_triangles(library, path.name) @ _UPRIGHT.T).reshape(-1, 3)
            except (FileNotFoundError, ValueError) as error:  # incomplete, or no numbers
                print(f"left out {path.name}: {error}")
                continue
            mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
            mesh.export(out / f"{path.stem}.stl")
            rows.append({"file": f"{path.stem}.stl", **header})
    with open(out / "table.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["file", "source", "licence", "family", "author",
                                       "mm_per_unit"])
        writer.writeheader()
        writer.writerows(rows)
    print(f"{len(rows)} parts")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:]))
