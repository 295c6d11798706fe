# SPDX-License-Identifier: Apache-2.0
"""Labels carried without depth: a coarse grid of space that outlines of other views leave."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.segmentation.prompted.color_models import RULED_OUT
from stack_counter.types import BACKGROUND, PARTS, View


@dataclass(frozen=True)
class OutlineCarrierSettings:
    """How much outlines of other views weigh; all chosen.

    Attributes:
        grid: number of voxels along each side.
        room: side of the grid over the width of the prompts at the distance of its middle.
        view_error: probability that a view errs about a voxel.
        first_view_error: probability of background where only the first view leaves the
            container.
        max_heap: largest probability of the heap where no container is marked: between parts
            lies background.
        max_parts: largest probability of parts in a container.
        min_probability: least probability of what is not background.
        cut_rounds: rounds of GrabCut.
        cut_inside, cut_outside: probability of background inside and outside of what GrabCut
            cuts out.
        undecided: probability of background where GrabCut is not asked.
        coarse_px: pixels of a view along one of the picture that voxels are drawn into.
        min_log_evidence: log evidence where no voxel is drawn.
    """

    grid: int = 48
    room: float = 1.5
    view_error: float = 0.05
    first_view_error: float = 0.7
    max_heap: float = 0.6
    max_parts: float = 0.6
    min_probability: float = 0.01
    cut_rounds: int = 4
    cut_inside: float = 0.03
    cut_outside: float = 0.9
    undecided: float = 0.4
    coarse_px: int = 4
    min_log_evidence: float = -20.0


SETTINGS = OutlineCarrierSettings()


class OutlineCarrier:
    """Keeps a soft visual hull of stack and container, and one of the parts inside it."""

    def __init__(self, views: list[View], marked: np.ndarray, container: bool):
        """Puts the grid where all cameras look at.

        Args:
            views: pinhole views.
            marked: (h, w) bool, pixels of the first view that prompts take in.
            container: whether the container is marked.

        Raises:
            ScanError: the cameras look along one direction.
        """
        self._container, self._marked = container, marked
        rows, cols = np.nonzero(marked)
        low, high = np.array([cols.min(), rows.min()]), np.array([cols.max(), rows.max()])
        center, distance = _find_middle(views, (low + high) / 2)
        side = SETTINGS.room * float(np.max(high - low)) / views[0].intrinsics.fx * distance
        axis = ((np.arange(SETTINGS.grid) + 0.5) / SETTINGS.grid - 0.5) * side
        self._voxels = (center + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"),
                                          axis=-1).reshape(-1, 3)).astype(np.float32)
        self._evidence = np.zeros((2, len(self._voxels)), np.float32)  # log: all; parts
        self._views = 0

    def background(self, view: View) -> np.ndarray:
        """Returns the (h, w) float32 probability of background in the first view, by GrabCut."""
        assert view.color is not None  # for the type checker: `check_views`
        if not self._container or self._marked.all():
            return np.full(self._marked.shape, SETTINGS.undecided, np.float32)
        seeds = np.where(self._marked, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
        cv2.setRNGSeed(0)  # it starts from k-means
        cv2.grabCut(np.ascontiguousarray(view.color[..., ::-1]), seeds, None, np.zeros((1, 65)),
                    np.zeros((1, 65)), SETTINGS.cut_rounds, cv2.GC_INIT_WITH_MASK)
        return np.where(seeds & 1, SETTINGS.cut_inside, SETTINGS.cut_outside).astype(np.float32)

    def prior(self, view: View) -> np.ndarray:
        """Returns (3, h, w) float32 probabilities: those of the best voxel on the pixel's ray."""
        foreground, parts = np.exp(self._draw_voxels(view))
        # Trust the hull more the more views have carved it.
        most = SETTINGS.max_heap
        if self._container:
            most = 1 - max(SETTINGS.first_view_error / self._views, SETTINGS.view_error)
        foreground = np.clip(foreground, SETTINGS.min_probability, most)
        # Split what is not background into container and parts.
        parts_share: np.ndarray | float = 1 - RULED_OUT
        if self._container:
            parts_share = np.clip(parts, 2 * SETTINGS.min_probability, SETTINGS.max_parts)
        parts = foreground * parts_share
        return np.stack([1 - foreground, foreground - parts, parts])

    def add(self, view: View, probabilities: np.ndarray) -> None:
        """Carves the hulls by a labelled view.

        Args:
            view: whose pose and calibration are used.
            probabilities: (3, h, w) float32 of its pixels.
        """
        pixels = geometry.project_into(view, self._voxels, np.float32)
        for evidence, p in zip(self._evidence,
                               (1 - probabilities[BACKGROUND], probabilities[PARTS])):
            wide = cv2.dilate(p, np.ones((3, 3)))  # a voxel is larger than a pixel
            evidence[pixels.inside] += np.log(np.clip(wide[pixels.rows, pixels.cols],
                                                        SETTINGS.view_error, 1))
        self._views += 1

    def _draw_voxels(self, view: View) -> np.ndarray:
        """Returns the (2, h, w) float32 log evidence of the best voxel that a pixel may show."""
        h, w = view.intrinsics.height, view.intrinsics.width
        pixels = geometry.project_into(view, self._voxels, np.float32)
        coarse = SETTINGS.coarse_px
        cells = pixels.rows // coarse, pixels.cols // coarse
        out = np.empty((2, h, w), np.float32)
        for picture, evidence in zip(out, self._evidence):
            # Draw coarsely, close the gaps between voxels, and enlarge.
            small = np.full((h // coarse + 1, w // coarse + 1), SETTINGS.min_log_evidence,
                            np.float32)
            np.maximum.at(small, cells, evidence[pixels.inside])
            small = cv2.dilate(small, np.ones((3, 3)))
            picture[:] = cv2.resize(small, (small.shape[1] * coarse, small.shape[0] * coarse),
                                    interpolation=cv2.INTER_LINEAR)[:h, :w]
        return out


def _find_middle(views: list[View], pixel: np.ndarray) -> tuple[np.ndarray, float]:
    """Finds the point nearest to the ray of a pixel of the first view and to all optical axes.

    Args:
        views: whose poses are used; the optical axis of the first one is not.
        pixel: (2,) of the first view.

    Returns:
        The point, (3,) metres, world, and its distance from the first camera, metres.

    Raises:
        ScanError: the rays are nearly parallel.
    """
    k = views[0].intrinsics
    aimed = np.array([(pixel[0] - k.cx) / k.fx, (pixel[1] - k.cy) / k.fy, 1.0])
    local = [aimed / np.linalg.norm(aimed), *[np.array([0, 0, 1.0])] * (len(views) - 1)]
    origins = np.array([v.T_world_camera[:3, 3] for v in views])
    ways = np.array([v.T_world_camera[:3, :3] @ way for v, way in zip(views, local)])
    center = geometry.nearest_point_to_rays(origins, ways)
    return center, float(np.linalg.norm(center - origins[0]))
