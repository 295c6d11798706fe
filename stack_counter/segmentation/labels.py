# SPDX-License-Identifier: Apache-2.0
"""Labels that came with the view, from any external node or annotator."""

from __future__ import annotations

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.types import View


def require_labels(view: View) -> np.ndarray:
    """Returns the (h, w) uint8 label image of a view.

    Raises:
        ViewError: reason `no_labels`, if the view has none.
    """
    if view.labels is None:
        raise ViewError("no_labels", "the view has no label image; expected one")
    return view.labels


class GivenLabelSegmenter:
    """Labels a view by the label image that came with it."""

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """Returns the (h, w) uint8 label image of every `stride`-th pixel.

        Raises:
            ViewError: reason `no_labels`, if the view has none.
        """
        return require_labels(view)[::stride, ::stride]
