# SPDX-License-Identifier: Apache-2.0
"""Which pixel shows parts: the `Segmenter` protocol and its implementations."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from stack_counter.types import View


class Segmenter(Protocol):
    """Labels one view at a time."""

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """Labels a view.

        Args:
            view: colour, depth or given labels, as the implementation needs them.
            stride: step between labelled pixels along rows and columns.

        Returns:
            (h, w) uint8 label image of every `stride`-th pixel (0, 1, 2; 254 unknown).
        """
        ...
