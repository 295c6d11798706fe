# SPDX-License-Identifier: Apache-2.0
"""Labels carried without depth: a coarse grid of space that outlines of other views leave."""

from __future__ import annotations

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.segmentation.prompted.color_models import NEVER
from stack_counter.types import BACKGROUND, PARTS, View

_SIDE = 48  # voxels along the grid
_ROOM = 1.5  # side of the grid over what the prompts' width is at the distance of the middle
_DOUBT = 0.05  # probability that a view errs about a voxel
_FIRST_DOUBT = 0.7  # probability of background where only the first view leaves the container
_HEAP = 0.6  # most that is said without a container: between parts lies background
_PARTS = 0.6  # most that is said of parts in a container
_LEAST = 0.01
_CUT_ROUNDS = 4  # of GrabCut
_CUT = (0.03, 0.9)  # probability of background inside and outside of what GrabCut cuts out
_UNDECIDED = 0.4  # the same where nothing is known
_COARSE = 4  # pixels of a view for one of the picture that voxels are drawn into


class OutlineCarrier:
    """A soft visual hull of the thing, and one of the parts inside it."""

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
        center, distance = _middle(views, (low + high) / 2)
        side = _ROOM * float(np.max(high - low)) / views[0].intrinsics.fx * distance
        axis = ((np.arange(_SIDE) + 0.5) / _SIDE - 0.5) * side
        self._voxels = (center + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"),
                                          axis=-1).reshape(-1, 3)).astype(np.float32)
        self._evidence = np.zeros((2, len(self._voxels)), np.float32)  # log: thing; parts
        self._views = 0

    def background(self, view: View) -> np.ndarray:
        """(h, w) float32 probability of background in the first view, by GrabCut."""
        assert view.color is not None  # for the type checker: `check_views`
        if not self._container or self._marked.all():
            return np.full(self._marked.shape, _UNDECIDED, np.float32)
        seeds = np.where(self._marked, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
        cv2.setRNGSeed(0)  # it starts from k-means
        cv2.grabCut(np.ascontiguousarray(view.color[..., ::-1]), seeds, None, np.zeros((1, 65)),
                    np.zeros((1, 65)), _CUT_ROUNDS, cv2.GC_INIT_WITH_MASK)
        return np.where(seeds & 1, *_CUT).astype(np.float32)

    def prior(self, view: View) -> np.ndarray:
        """(3, h, w) float32 probabilities: the best voxel on the pixel's ray."""
        thing, parts = np.exp(self._drawn(view))
        most = 1 - max(_FIRST_DOUBT / self._views, _DOUBT) if self._container else _HEAP
        thing = np.clip(thing, _LEAST, most)
        parts = thing * (np.clip(parts, 2 * _LEAST, _PARTS) if self._container else 1 - NEVER)
        return np.stack([1 - thing, thing - parts, parts])

    def add(self, view: View, probabilities: np.ndarray) -> None:
        """Takes from the hull what a labelled view, (3, h, w) float32, does not show."""
        pixels = geometry.project_into(view, self._voxels, np.float32)
        for evidence, p in zip(self._evidence,
                               (1 - probabilities[BACKGROUND], probabilities[PARTS])):
            wide = cv2.dilate(p, np.ones((3, 3)))  # a voxel is larger than a pixel
            evidence[pixels.inside] += np.log(np.clip(wide[pixels.rows, pixels.cols], _DOUBT, 1))
        self._views += 1

    def _drawn(self, view: View) -> np.ndarray:
        """(2, h, w) float32 log evidence of the best voxel that a pixel may show."""
        h, w = view.intrinsics.height, view.intrinsics.width
        pixels = geometry.project_into(view, self._voxels, np.float32)
        cells = pixels.rows // _COARSE, pixels.cols // _COARSE
        out = np.empty((2, h, w), np.float32)
        for picture, evidence in zip(out, self._evidence):
            small = np.full((h // _COARSE + 1, w // _COARSE + 1), -20, np.float32)
            np.maximum.at(small, cells, evidence[pixels.inside])
            small = cv2.dilate(small, np.ones((3, 3)))
            picture[:] = cv2.resize(small, (small.shape[1] * _COARSE, small.shape[0] * _COARSE),
                                    interpolation=cv2.INTER_LINEAR)[:h, :w]
        return out


def _middle(views: list[View], pixel: np.ndarray) -> tuple[np.ndarray, float]:
    """The point, (3,) metres, closest to the ray of a pixel of the first view and to the optical
    axes of the others; its distance from the first camera, metres."""
    k = views[0].intrinsics
    aimed = np.array([(pixel[0] - k.cx) / k.fx, (pixel[1] - k.cy) / k.fy, 1.0])
    local = [aimed / np.linalg.norm(aimed), *[np.array([0, 0, 1.0])] * (len(views) - 1)]
    origins = np.array([v.T_world_camera[:3, 3] for v in views])
    ways = np.array([v.T_world_camera[:3, :3] @ way for v, way in zip(views, local)])
    center = geometry.nearest_point_to_rays(origins, ways)
    return center, float(np.linalg.norm(center - origins[0]))
