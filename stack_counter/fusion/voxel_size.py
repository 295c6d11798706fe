"""The side of a voxel where no setting says it."""

from __future__ import annotations

from stack_counter.fusion.region import Region

COARSEST, _FINEST = 0.002, 0.001  # m; the first for parts and containers of any size
_MOST_VOXELS = 400  # along a side of the region before they become larger than that
_PER_PART = 4  # voxels in the cube root of a part's volume


def automatic_voxel_size(region: Region, unit_volume: float) -> float:
    """Side of a voxel, m: of a size that all calibrations were made for, larger in a large region,
    smaller for parts (m3; 0: not known) that are only a few of them wide."""
    size = max(COARSEST, float((region.high - region.low)[:2].max()) / _MOST_VOXELS)
    return min(size, voxel_size_for(unit_volume)) if unit_volume else size


def voxel_size_for(unit_volume: float) -> float:
    """Side of a voxel, m, for parts of `unit_volume` (m3) in a region of usual size."""
    return min(COARSEST, max(unit_volume ** (1 / 3) / _PER_PART, _FINEST))
