"""Labels that came with the view, from any external node or annotator."""

from __future__ import annotations

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.types import View


def require_labels(view: View) -> np.ndarray:
    """(h, w) uint8 label image of the view.

    Raises:
        ViewError: reason `no_labels`.
    """
    if view.labels is None:
        raise ViewError("no_labels", "the view has no label image; expected one")
    return view.labels


class GivenLabels:
    """Passes a view's own label image on."""

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """(h, w) uint8 label image of every `stride`-th pixel.

        Raises:
            ViewError: reason `no_labels`.
        """
        return require_labels(view)[::stride, ::stride]
