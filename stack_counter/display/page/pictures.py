# SPDX-License-Identifier: Apache-2.0
"""Pictures of a report as data that lies in the page itself."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.display.drawings import LABEL_TINTS, height_colors
from stack_counter.display.page.surfaces import container_rings
from stack_counter.display.visible_parts import outlines_in_view
from stack_counter.types import UNSEEN, KeyView, StackCount, StackVolume


@dataclass(frozen=True)
class PictureSettings:
    """How pictures are stored; all chosen.

    Attributes:
        webp_quality: of photographs and the poster, 0 to 100.
        max_side_px: a larger key view is reduced to it.
        tint_alpha: how much of a labelled pixel is tint, 0 to 255.
        scale_mm: lengths that a scale may have, mm.
        scale_share: the longest of them up to this share of the map's width is taken.
        max_lines: of the container's wall in the key view.
    """

    webp_quality: int = 82
    max_side_px: int = 1024
    tint_alpha: int = 100
    scale_mm: tuple[int, ...] = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
    scale_share: float = 0.4
    max_lines: int = 8


SETTINGS = PictureSettings()


@dataclass(frozen=True)
class KeyPicture:
    """The key view in layers.

    Attributes:
        width, height: pixels.
        photo: data URI of the picture; of the labels in grey where there is no colour.
        labels: data URI of the tinted labels, else transparent.
        outlines: lines of the container's inner wall: `x,y x,y ...`, pixels.
        parts: outlines of the parts that show, the same.
    """

    width: int
    height: int
    photo: str
    labels: str
    outlines: tuple[str, ...]
    parts: tuple[str, ...]


@dataclass(frozen=True)
class HeightPicture:
    """The map of the top surface.

    Attributes:
        width, height: cells.
        image: data URI, one pixel a cell, y upwards.
        low_mm, high_mm: heights of the darkest and the brightest colour.
        scale_mm: length of the scale, mm.
        scale_cells: the same in cells.
    """

    width: int
    height: int
    image: str
    low_mm: float
    high_mm: float
    scale_mm: int
    scale_cells: float


def key_picture(count: StackCount) -> KeyPicture | None:
    """Returns the key view in layers; None where no view showed parts."""
    volume, view = count.volume, count.volume.key_view
    if view is None or not view.labels.size:
        return None
    if view.color is not None:
        photo = np.ascontiguousarray(view.color[..., ::-1])
    else:
        photo = cv2.cvtColor(np.where(view.labels == UNSEEN, 0, 60 + view.labels * 70)
                             .astype(np.uint8), cv2.COLOR_GRAY2BGR)
    tints = np.zeros((*view.labels.shape, 4), np.uint8)
    for label, tint in LABEL_TINTS.items():
        tints[view.labels == label] = (*tint, SETTINGS.tint_alpha)
    height, width = view.labels.shape
    shrink = min(SETTINGS.max_side_px / max(height, width), 1.0)
    if shrink < 1:
        photo = cv2.resize(photo, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        tints = cv2.resize(tints, photo.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    parts = outlines_in_view(count.visible_parts or (), view)
    return KeyPicture(width, height, webp_uri(photo), png_uri(tints), _outlines(volume, view),
                      tuple(map(_svg_points, parts)))


def _outlines(volume: StackVolume, view: KeyView) -> tuple[str, ...]:
    """Returns the container's lines in pixels; none where one would reach behind the camera."""
    rings = container_rings(volume)
    if rings is None:
        return ()
    local = geometry.apply(geometry.inverse(view.T_world_camera), rings)
    if (local[..., 2] <= 0).any():
        return ()
    pixels, _ = geometry.project(local, view.intrinsics)  # (k, n, 2)
    step = max(pixels.shape[1] // SETTINGS.max_lines, 1)
    lines = [*(np.concatenate([ring, ring[:1]]) for ring in (pixels[0], pixels[-1])),
             *(pixels[:, i] for i in range(0, pixels.shape[1], step))]
    return tuple(map(_svg_points, lines))


def _svg_points(line: np.ndarray) -> str:
    """Returns (n, 2) pixels, whose middles are whole numbers, as points of an SVG."""
    return " ".join(f"{x + 0.5:.1f},{y + 0.5:.1f}" for x, y in line)


def height_picture(volume: StackVolume) -> HeightPicture | None:
    """Returns the map of the top surface; None where there is none."""
    top = volume.top
    if top is None or not np.isfinite(top.heights).any():
        return None
    rows, cols = np.nonzero(np.isfinite(top.heights))
    heights = top.heights[rows.min():rows.max() + 1, cols.min():cols.max() + 1]
    colors = np.dstack([height_colors(heights[::-1]),
                        255 * np.isfinite(heights[::-1]).astype(np.uint8)])
    height, width = heights.shape
    fitting = [mm for mm in SETTINGS.scale_mm
               if mm * 1e-3 <= SETTINGS.scale_share * width * top.pitch]
    scale = max(fitting, default=SETTINGS.scale_mm[0])
    return HeightPicture(width, height, png_uri(colors), 1000 * float(np.nanmin(heights)),
                         1000 * float(np.nanmax(heights)), scale, scale * 1e-3 / top.pitch)


def webp_uri(picture: np.ndarray) -> str:
    """Returns the data URI of a (h, w, 3) BGR or (h, w, 4) BGRA uint8 picture, with loss."""
    data = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, SETTINGS.webp_quality])[1]
    return data_uri("image/webp", data.tobytes())


def png_uri(picture: np.ndarray) -> str:
    """Returns the data URI of a (h, w, 4) uint8 BGRA picture, without loss."""
    return data_uri("image/png", cv2.imencode(".png", picture)[1].tobytes())


def data_uri(kind: str, data: bytes) -> str:
    """Returns data of a MIME type as a URI that holds them."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
