# SPDX-License-Identifier: Apache-2.0
"""The key view: the one that shows the most parts, cropped to them.

Source: paper, section 3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.segmentation import Segmenter
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import PARTS, KeyView, View

_STRIDE_PX = 4
_MAX_PIXELS = 20_000  # of a view in which parts are counted, about


def find_key_view(views: Sequence[View], segmenter: Segmenter) -> KeyView | None:
    """Chooses the view with the most part pixels and crops it to them.

    Part pixels are counted on every fourth row and column, on fewer of large images.

    Args:
        views: views of one scan, one or more.
        segmenter: labels each of them.

    Returns:
        The crop; None where no view shows parts.
    """
    part_pixels = []
    for view in views:
        stride = geometry.stride_for(view, _STRIDE_PX, _MAX_PIXELS)
        counted = np.count_nonzero(segmenter.segment(view, stride) == PARTS)
        part_pixels.append(counted * stride**2)
    best = views[int(np.argmax(part_pixels))]
    labels = segmenter.segment(best)
    rows, cols = np.nonzero(labels == PARTS)
    if not len(rows):
        return None
    crop = geometry.crop(replace(best, labels=labels), np.array([cols.min(), rows.min()]),
                         np.array([cols.max(), rows.max()]))
    return KeyView(stamp_ns=best.stamp_ns, intrinsics=crop.intrinsics,
                   T_world_camera=crop.T_world_camera, part_pixels=len(rows),
                   labels=require_labels(crop), depth=crop.depth, color=crop.color)
