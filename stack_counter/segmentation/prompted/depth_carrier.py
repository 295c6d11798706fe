# SPDX-License-Identifier: Apache-2.0
"""Labels carried by depth: every pixel is a point, and voxels of the world keep its votes."""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.segmentation.prompted.color_models import CLASSES, NEVER
from stack_counter.types import View

_CELL = 0.003  # side of a voxel that keeps votes, m
_MOST_CELLS = 150  # along the region's longest side
_LOW, _LOW_STEP = 0.0035, 0.001  # height where plane and thing are equally likely, and a step, m
_SURE = 0.97  # the most that height alone says
_UNKNOWN = 0.3  # probability of background without depth
_ONE_VIEW = 2.0  # votes of a voxel that weigh as much as what height says


class DepthCarrier:
    """Background is what lies on the support plane or outside of the region; votes say the rest.
    """

    def __init__(self, region: Region, container: bool):
        """`container`: whether it is marked; if not, what stands in the region is parts."""
        self._region = region
        self._parts_share = 0.5 if container else 1 - NEVER  # of what is not background
        size = region.high - region.low
        self._cell = max(_CELL, float(size.max()) / _MOST_CELLS)
        self._votes = np.zeros((*np.ceil(size / self._cell).astype(int), CLASSES), np.float32)

    def background(self, view: View) -> np.ndarray:
        """(h, w) float32 probability of background from height and region."""
        points = geometry.world_points(view)
        height = points[..., 2] - self._region.plane_z
        low = 1 / (1 + np.exp(np.clip((height - _LOW) / _LOW_STEP, -8, 8)))
        p = np.where(self._region.contains(points), np.clip(low, 1 - _SURE, _SURE), 1 - 1e-3)
        return np.where(np.isfinite(height), p, _UNKNOWN).astype(np.float32)

    def prior(self, view: View) -> np.ndarray:
        """(3, h, w) float32 probabilities: votes of the pixel's voxel, and its height."""
        base = self.background(view)
        parts = (1 - base) * self._parts_share
        p = np.stack([base, 1 - base - parts, parts])
        known, voxels = self._voxels(view)
        votes = self._votes[voxels].T  # (3, n)
        p[:, known] = (votes + _ONE_VIEW * p[:, known]) / (votes.sum(axis=0) + _ONE_VIEW)
        return p

    def add(self, view: View, probabilities: np.ndarray) -> None:
        """Votes for the voxels that a labelled view shows; (3, h, w) float32."""
        known, voxels = self._voxels(view)
        np.add.at(self._votes, voxels, probabilities[:, known].T)

    def _voxels(self, view: View) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """(h, w) bool pixels in the region, and the indices of their voxels."""
        points = geometry.world_points(view)
        known = self._region.contains(points)
        index = np.floor((points[known] - self._region.low) / self._cell).astype(int)
        return known, tuple(np.minimum(index, np.array(self._votes.shape[:3]) - 1).T)
