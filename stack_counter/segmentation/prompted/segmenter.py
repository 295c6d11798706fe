# SPDX-License-Identifier: Apache-2.0
"""Labels from prompts in the first view, carried to all views by their poses; no weights needed.

    labels = PromptedSegmenter(config).segment_views(views, read_prompts(path))

The first view: the prompts say what may be what, and colour models of background, container and
parts are learnt and used in turn. Every other view: what the views before it say of the same
place in space, times the colour models, which go on learning.

Source of the alternation: Rother, Kolmogorov and Blake, "GrabCut" (2004); here with three classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ViewError
from stack_counter.fusion.region import find_region
from stack_counter.segmentation.prompted.color_models import (
    NEVER,
    ColorModels,
    color_bins,
    smoothed,
)
from stack_counter.segmentation.prompted.depth_carrier import DepthCarrier
from stack_counter.segmentation.prompted.first_view import label_first, marked, prompted_prior
from stack_counter.segmentation.prompted.outline_carrier import OutlineCarrier
from stack_counter.segmentation.prompts import Prompts
from stack_counter.types import View

_LARGEST = 640  # longest side of the images that are worked on, pixels


class PromptedSegmenter:
    """Colour models and poses; depth where all views have it."""

    def __init__(self, config: ReconstructorConfig):
        """`config`: a configured region of interest is used as given."""
        self._config = config

    def segment_views(self, views: Sequence[View], prompts: Prompts) -> list[np.ndarray]:
        """Labels every view of a scan.

        Args:
            views: rectified views with colour and poses.
            prompts: marks in `views[0]`.

        Returns:
            (h, w) uint8 label images (0, 1, 2), one for each view.

        Raises:
            PromptError: the prompts do not fit the first view.
            ViewError: reason `no_color`.
            ScanError: no support plane in depth views; or no depth and one direction of sight.
        """
        if not views:
            return []
        check_views(views, prompts)
        small = [_shrunk(view) for view in views]
        first = small[0].intrinsics
        marks = prompts.scaled(np.array([first.width / views[0].intrinsics.width,
                                         first.height / views[0].intrinsics.height]))
        carrier: DepthCarrier | OutlineCarrier
        if all(view.depth is not None for view in views):
            region = find_region(list(views), self._config)
            carrier = DepthCarrier(region, prompts.with_container)
        else:
            area = marked(marks, (first.height, first.width))
            carrier = OutlineCarrier(small, area, prompts.with_container)
        return [_label_image(p, view) for p, view in zip(_carry(small, carrier, marks), views)]


def check_views(views: Sequence[View], prompts: Prompts) -> None:
    """Refuses what no segmenter with prompts can work with.

    Raises:
        PromptError: the prompts do not fit the first view.
        ViewError: reason `no_color`.
    """
    for view in views:
        if view.color is None:
            raise ViewError("no_color", "the view has no colour image; expected one")
    prompts.check(views[0].intrinsics.width, views[0].intrinsics.height)


def _carry(views: list[View], carrier: DepthCarrier | OutlineCarrier, prompts: Prompts
           ) -> list[np.ndarray]:
    """(3, h, w) float32 probabilities for every view."""
    colors = [view.color for view in views if view.color is not None]
    looks, bins = ColorModels(), [color_bins(color) for color in colors]
    asked, points = prompted_prior(carrier.background(views[0]), prompts)
    found = [label_first(colors[0], bins[0], asked, points, looks)]
    carrier.add(views[0], found[0])
    for view, color, seen in list(zip(views, colors, bins))[1:]:
        prior = np.maximum(carrier.prior(view), NEVER)
        found.append(smoothed(np.log(prior) + looks.log(seen), color))
        looks.add(seen, found[-1])
        carrier.add(view, found[-1])
    return found


def _shrunk(view: View) -> View:
    """The view at the size that is worked on."""
    k = view.intrinsics
    scale = min(1.0, _LARGEST / max(k.width, k.height))
    if scale == 1 or view.color is None:
        return view
    width, height = round(k.width * scale), round(k.height * scale)
    x, y = width / k.width, height / k.height
    smaller = replace(k, width=width, height=height, fx=k.fx * x, fy=k.fy * y,
                      cx=(k.cx + 0.5) * x - 0.5, cy=(k.cy + 0.5) * y - 0.5)
    return replace(view, intrinsics=smaller, labels=None, color=cv2.resize(
        view.color, (width, height), interpolation=cv2.INTER_AREA), depth=None
        if view.depth is None else cv2.resize(view.depth, (width, height),
                                              interpolation=cv2.INTER_NEAREST_EXACT))


def _label_image(probabilities: np.ndarray, view: View) -> np.ndarray:
    """(h, w) uint8 label image of the full view from (3, n, m) probabilities."""
    k = view.intrinsics
    large = [cv2.resize(p, (k.width, k.height), interpolation=cv2.INTER_LINEAR)
             for p in probabilities]
    return np.argmax(large, axis=0).astype(np.uint8)
