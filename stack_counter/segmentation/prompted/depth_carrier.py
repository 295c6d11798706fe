# SPDX-License-Identifier: Apache-2.0
"""Labels carried by depth: every pixel is a point, and voxels of the world keep its votes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.segmentation.prompted.color_models import NUM_CLASSES, RULED_OUT
from stack_counter.types import View


@dataclass(frozen=True)
class DepthCarrierSettings:
    """How much heights and votes weigh; all chosen.

    Attributes:
        cell_m: smallest side of a voxel that keeps votes, m.
        max_cells: largest number of voxels along the region's longest side.
        plane_height_m: height above the support plane at which background and the rest are
            equally likely, m.
        plane_height_step_m: change of height that changes the odds by a factor of e, m.
        max_height_probability: largest probability that height alone gives.
        outside_probability: probability of background outside of the region.
        unknown_probability: probability of background without depth.
        prior_votes: number of votes in a voxel that weigh as much as its height.
    """

    cell_m: float = 0.003
    max_cells: int = 150
    plane_height_m: float = 0.0035
    plane_height_step_m: float = 0.001
    max_height_probability: float = 0.97
    outside_probability: float = 1 - 1e-3
    unknown_probability: float = 0.3
    prior_votes: float = 2.0


SETTINGS = DepthCarrierSettings()


class DepthCarrier:
    """Tells background by height and region, parts and container by the votes of other views."""

    def __init__(self, region: Region, container: bool):
        """Makes a grid without votes.

        Args:
            region: box around stack and container, with the height of the support plane.
            container: whether it is marked; if not, what stands in the region is parts.
        """
        self._region = region
        self._parts_share = 0.5 if container else 1 - RULED_OUT  # of what is not background
        size = region.high - region.low
        self._cell = max(SETTINGS.cell_m, float(size.max()) / SETTINGS.max_cells)
        self._votes = np.zeros((*np.ceil(size / self._cell).astype(int), NUM_CLASSES), np.float32)

    def background(self, view: View) -> np.ndarray:
        """Returns the (h, w) float32 probability of background from height and region."""
        points = geometry.world_points(view)
        height = points[..., 2] - self._region.plane_z
        # Low points lie on the support plane.
        steps = (height - SETTINGS.plane_height_m) / SETTINGS.plane_height_step_m
        on_plane = 1 / (1 + np.exp(np.clip(steps, -8, 8)))
        most = SETTINGS.max_height_probability
        p = np.where(self._region.contains(points), np.clip(on_plane, 1 - most, most),
                     SETTINGS.outside_probability)
        return np.where(np.isfinite(height), p, SETTINGS.unknown_probability).astype(np.float32)

    def prior(self, view: View) -> np.ndarray:
        """Returns (3, h, w) float32 probabilities: votes of the pixel's voxel, and its height."""
        base = self.background(view)
        parts = (1 - base) * self._parts_share
        p = np.stack([base, 1 - base - parts, parts])
        in_region, voxels = self._find_voxels(view)
        votes = self._votes[voxels].T  # (3, n)
        p[:, in_region] = (votes + SETTINGS.prior_votes * p[:, in_region]) / (
            votes.sum(axis=0) + SETTINGS.prior_votes)
        return p

    def add(self, view: View, probabilities: np.ndarray) -> None:
        """Adds the votes of a labelled view to its voxels.

        Args:
            view: with depth.
            probabilities: (3, h, w) float32 of its pixels.
        """
        in_region, voxels = self._find_voxels(view)
        np.add.at(self._votes, voxels, probabilities[:, in_region].T)

    def _find_voxels(self, view: View) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Returns (h, w) bool pixels in the region, and the indices of their voxels."""
        points = geometry.world_points(view)
        in_region = self._region.contains(points)
        index = np.floor((points[in_region] - self._region.low) / self._cell).astype(int)
        return in_region, tuple(np.minimum(index, np.array(self._votes.shape[:3]) - 1).T)
