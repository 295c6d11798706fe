"""v from a scan of pieces that lie apart on a table (paper, section 3.3, "Unit volume").

What lies below a piece is not seen from above: its height map holds more than the piece. Views
from aside carve some of that away, and a piece in another rest pose hides other places. How much
is left over a ridge regression says, fitted to simulated parts (`train.template`), from what the
pieces look like.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import PartError, ScanError, ViewError
from stack_counter.fusion.region import find_pieces
from stack_counter.reconstruction import DepthReconstruction
from stack_counter.types import StackVolume, View

FORMAT = "stack_counter template 1"
_VOXEL = 0.001  # m
_LEAST_VIEWS = 6
_SPECK = 0.02  # of the largest piece: what is smaller is none
_GAPS = range(8)  # cells within which fragments belong together
_BEHIND = 0.0015  # m, that a surface must lie behind a place to prove it empty
_UNLIKE = 5.0  # times the smallest, above which the largest piece is none of the same part
_ROUND = 0.06  # log deviation of the pieces' volumes below which all poses look alike


@dataclass(frozen=True)
class Template:
    """What a scan of K pieces shows.

    Attributes:
        carved: (K,) m3 that no view has proven empty of each piece.
        features: (n,) what the regression reads.
    """

    carved: np.ndarray
    features: np.ndarray

    @property
    def alike(self) -> bool:
        """Whether all pieces look the same: a round part, or all in one pose."""
        return bool(np.log(self.carved).std() < _ROUND)


@dataclass(frozen=True)
class TemplateModel:
    """Ridge regression of log v over the smallest piece's carved volume.

    Attributes:
        mean, scale: (n,) of the features; weights: (m,) of their polynomial, constant first.
        std: (3,) relative standard deviation of v on families left out: its constant, and its
            decrease with the number of pieces and the part's size.
    """

    mean: np.ndarray
    scale: np.ndarray
    weights: np.ndarray
    std: np.ndarray

    def unit_volume(self, template: Template) -> tuple[float, float]:
        """v and its standard deviation, m3."""
        x = polynomial((template.features - self.mean) / self.scale)
        v = float(template.carved.min() * np.exp(x @ self.weights))
        return v, v * relative_std(self.std, len(template.carved), v)


def relative_std(std: np.ndarray, pieces: int, unit_volume: float) -> float:
    """Standard deviation of v over v, by the number of pieces and v (m3)."""
    return float(np.sqrt(std[0]**2 + std[1]**2 / pieces
                         + std[2]**2 * (1e-6 / unit_volume) ** (2 / 3)))


def polynomial(x: np.ndarray) -> np.ndarray:
    """(m,) 1, the features and their squares; features limited to what was seen."""
    x = np.clip(x, -2.5, 2.5)
    return np.concatenate([[1.0], x, x**2])


@cache
def shipped() -> TemplateModel:
    """The model that comes with the package."""
    path = Path(str(resources.files("stack_counter") / "weights" / "template.json"))
    document = json.loads(path.read_text())
    if document.pop("format") != FORMAT:
        raise PartError(f"{path} is no template model; expected '{FORMAT}'")
    return TemplateModel(**{key: np.array(value) for key, value in document.items()})


def scan_template(views: list[View], pieces: int, config: ReconstructorConfig) -> Template:
    """Reconstructs pieces that lie apart.

    Args:
        views: of one scan, with depth.
        pieces: how many there are.
        config: settings; container and voxel size are not used.

    Raises:
        ScanError: no region, no surface, another number of pieces, or pieces too unlike.
    """
    views = [view for view in views if view.depth is not None]
    if len(views) < _LEAST_VIEWS:
        raise ScanError(f"{len(views)} views with depth; expected at least {_LEAST_VIEWS}, from "
                        "all sides: what no view sees counts as part of the pieces")
    region = find_pieces(views, config)
    middle, size = (region.low + region.high) / 2, region.high - region.low
    scan = DepthReconstruction(replace(
        config, container="", container_kind="none", voxel_size=_VOXEL, live=False,
        roi_center_m=tuple(map(float, middle)), roi_size_m=tuple(map(float, size))))
    for view in views:
        with suppress(ViewError):  # the others go on
            scan.add(geometry.rectify(view))
    return template_of(scan.measure(taught=None), scan.views, pieces)


def template_of(volume: StackVolume, views: list[View], pieces: int) -> Template:
    """Tells the pieces of a volume without container apart and measures each.

    Args:
        volume: of kind `none`.
        views: what it was made from.
        pieces: how many there are.

    Raises:
        ScanError: another number of pieces, or pieces too unlike to be whole.
    """
    assert volume.top is not None  # scans without depth are refused before
    heights, pitch = volume.top.heights, volume.top.pitch
    names = _apart(np.isfinite(heights), pieces)
    carved, looks = [], []
    for name in range(1, pieces + 1):
        rows, cols = np.nonzero(names == name)
        tall = heights[rows, cols]
        xy = (np.stack([cols, rows], axis=1) + 0.5) * pitch
        full = float(tall.sum()) * pitch**2
        left = _carved(xy, tall, volume.top.T_world_map, views) * pitch**2 * _VOXEL
        carved.append(max(left, 0.05 * full))
        looks.append(_look(xy, tall, pitch, full, carved[-1]))
    v, all_looks = np.array(carved), np.array(looks)
    if v.max() > _UNLIKE * v.min():
        raise ScanError(f"the largest piece seen is {v.max() / v.min():.1f} times the smallest; "
                        f"expected whole pieces of one part, less than {_UNLIKE:.0f} times apart "
                        "(parts this thin or small are not seen whole: count a bin instead)")
    smallest = int(np.argmin(v))
    features = np.concatenate([
        all_looks.mean(axis=0), all_looks[smallest],
        [np.log(v.mean() / v.min()), np.log(v).std(), np.log(v.min()) / 3 + 5,
         1 / np.sqrt(pieces), 1 / len(views)]])
    return Template(v, features)


def _apart(standing: np.ndarray, pieces: int) -> np.ndarray:
    """(rows, cols) names 1 to `pieces`: fragments closer than a few cells belong together."""
    found = []
    for gap in _GAPS:
        joined = cv2.dilate(standing.astype(np.uint8), np.ones((2 * gap + 1,) * 2)) > 0
        names, count = ndimage.label(joined, np.ones((3, 3)))
        names = np.where(standing, names, 0)
        areas = np.bincount(names.ravel(), minlength=count + 1)[1:]
        large = [i + 1 for i, a in enumerate(areas) if a > _SPECK * areas.max()] if count else []
        found.append(len(large))
        if len(large) == pieces:
            order = np.zeros(count + 1, int)
            order[large] = np.arange(1, pieces + 1)
            return order[names]
    raise ScanError(f"{found[0]} pieces lie on the table; expected {pieces}, more than "
                    f"{_GAPS[-1]} mm apart")


def _carved(xy: np.ndarray, tall: np.ndarray, T_world_map: np.ndarray, views: list[View]) -> float:
    """Voxels below (n,) heights over (n, 2) cells that no view looks through."""
    levels = np.arange(0, float(tall.max()), _VOXEL) + _VOXEL / 2
    below = levels[None] < tall[:, None]
    points = np.concatenate([np.repeat(xy[:, None], len(levels), axis=1),
                             np.broadcast_to(levels[None, :, None], (*below.shape, 1))], axis=2)
    points = geometry.apply(T_world_map, points[below])
    empty = np.zeros(len(points), int)
    for view in views:
        assert view.depth is not None  # as above
        pixels = geometry.project_into(view, points)
        empty[pixels.inside] += view.depth[pixels.rows, pixels.cols] > pixels.depth + _BEHIND
    return float(np.count_nonzero(empty < 2))


def _look(xy: np.ndarray, tall: np.ndarray, pitch: float, full: float, carved: float
          ) -> np.ndarray:
    """(7,) logs of what one piece looks like: how much was carved away, how full its box and its
    hull are, how convex its outline, how flat and long it is, how even its top."""
    area, highest = len(xy) * pitch**2, float(np.percentile(tall, 98))
    try:
        outline = ConvexHull(xy)
        solid = ConvexHull(np.concatenate([np.column_stack([xy, tall]),
                                           np.column_stack([xy, np.zeros(len(xy))])]))
        hull_area, hull = float(outline.volume), float(solid.volume)
    except QhullError:
        hull_area, hull = area, full
    values, _ = np.linalg.eigh(np.cov(xy.T) + np.eye(2) * pitch**2)
    return np.array([np.log(carved / full), np.log(full / (area * highest)),
                     np.log(full / hull), np.log(area / hull_area),
                     np.log(highest / np.sqrt(area)), np.log(values[1] / values[0]) / 4,
                     np.log(tall.std() / highest + 0.02) / 2])
