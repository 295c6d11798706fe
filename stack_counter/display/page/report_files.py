# SPDX-License-Identifier: Apache-2.0
"""The page of a report and the files of its model."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from stack_counter.display.drawings import write_ply
from stack_counter.display.page.arranged_parts import arrangement_to_show
from stack_counter.display.page.model import build_glb
from stack_counter.display.page.page import render_page
from stack_counter.display.page.pictures import webp_uri
from stack_counter.display.page.poster import draw_poster
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.page.surfaces import container_to_show, surface_to_show
from stack_counter.files import write_atomically
from stack_counter.types import Mesh, StackCount

PAGE, MODEL, PICTURE = "report.html", "surface.glb", "surface.png"
ARRANGEMENT, PLAUSIBLE_PARTS = "plausible_parts.ply", "plausible parts"


def write_page(folder: Path, count: StackCount, subject: ReportSubject,
               beside: Iterable[str]) -> None:
    """Writes the page, and beside it the model and its picture where a surface is known.

    Args:
        folder: is there.
        count: final count.
        subject: what it is of.
        beside: names of the other files of the report in that folder, to which the page links.

    Raises:
        OSError: the folder cannot be written.
    """
    shown = {"surface": surface_to_show(count.volume),
             "container": container_to_show(count.volume)}
    meshes = {name: mesh for name, mesh in shown.items() if mesh is not None}
    files, glb, poster = list(beside), b"", ""
    if shown["surface"] is not None:
        T = count.volume.container.T_world_container
        picture = draw_poster(meshes.values(), math.atan2(T[1, 0], T[0, 0]))
        glb, poster = build_glb(meshes), webp_uri(picture)
        (folder / MODEL).write_bytes(glb)
        if not cv2.imwrite(str(folder / PICTURE), _on_white(picture)):
            raise OSError(f"cannot write {folder / PICTURE}")
        files += [MODEL, PICTURE]
        if (parts := _arranged_parts(subject)) is not None:
            glb = build_glb({**meshes, PLAUSIBLE_PARTS: parts}, hidden=PLAUSIBLE_PARTS)
            write_ply(folder / ARRANGEMENT, parts)
            files.append(ARRANGEMENT)
    write_atomically(folder / PAGE, render_page(count, subject, glb, poster, sorted(files)))


def _arranged_parts(subject: ReportSubject) -> Mesh | None:
    """Returns what may lie below the surface; None where nothing is known of it."""
    return None if subject.arrangement is None else arrangement_to_show(subject.arrangement)


def _on_white(picture: np.ndarray) -> np.ndarray:
    """Returns a (h, w, 4) uint8 BGRA picture as (h, w, 3) BGR on white."""
    alpha = picture[..., 3:] / 255
    return (picture[..., :3] * alpha + 255 * (1 - alpha)).round().astype(np.uint8)
