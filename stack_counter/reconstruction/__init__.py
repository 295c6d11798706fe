# SPDX-License-Identifier: Apache-2.0
"""Views become a `StackVolume`: V, its error, and what the network reads."""

from stack_counter.reconstruction.depth import DepthReconstruction
from stack_counter.reconstruction.pictures import PictureReconstruction

__all__ = ["DepthReconstruction", "PictureReconstruction"]
