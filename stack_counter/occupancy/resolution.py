# SPDX-License-Identifier: Apache-2.0
"""How finely a surface is resolved, as numbers that the gamma-network reads.

A surface measured coarsely is smooth, and so is one of full parts: only who knows the resolution
can tell them apart. Stereo on pictures does more to a surface than its window says, so the network
also reads where the surface comes from.
"""

from __future__ import annotations

import numpy as np

from stack_counter.types import Reason, StackVolume

RESOLUTION_VALUES = 2  # log of the resolution over the usual one, and whether stereo measured it
# Part lengths; median of the training scenes' voxels. Where nothing is known, zeros stand for it.
_USUAL = 0.16


def resolution_values(resolution: float, from_pictures: bool) -> np.ndarray:
    """(RESOLUTION_VALUES,) float32 that the network reads.

    Args:
        resolution: length that the surface resolves, part lengths; 0 if unknown.
        from_pictures: the surface comes from stereo on pictures, not from a depth camera.
    """
    log = np.log(resolution / _USUAL) if resolution > 0 else 0.0
    return np.array([log, from_pictures], np.float32)


def measured_resolution(volume: StackVolume, unit_volume: float) -> np.ndarray:
    """(RESOLUTION_VALUES,) float32 of a reconstruction; its cells' side where it gives no length.

    Args:
        volume: the reconstruction.
        unit_volume: v, m3.
    """
    length = volume.resolution_m or (volume.top.pitch if volume.top is not None else 0.0)
    return resolution_values(length / unit_volume ** (1 / 3),
                             Reason.DEPTH_FROM_PICTURES in volume.reasons)
