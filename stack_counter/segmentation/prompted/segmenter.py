# SPDX-License-Identifier: Apache-2.0
"""Labels from prompts in the first view, carried to all views by their poses; no weights needed.

    labels = PromptedSegmenter(config).segment_views(views, read_prompts(path))

In the first view, prompts give the prior, and colour models of background, container and parts
are fitted in turn with the labels. In every other view, the prior comes from the labels of earlier
views at the same place in space, and the likelihood from the colour models, which each labelled
view updates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ViewError
from stack_counter.fusion.region import find_region
from stack_counter.segmentation.prompted.color_models import (
    RULED_OUT,
    ColorModels,
    compute_color_bins,
    smooth_to_probabilities,
)
from stack_counter.segmentation.prompted.depth_carrier import DepthCarrier
from stack_counter.segmentation.prompted.first_view import (
    compute_prompted_prior,
    find_marked_area,
    label_first_view,
)
from stack_counter.segmentation.prompted.outline_carrier import OutlineCarrier
from stack_counter.segmentation.prompts import Prompts
from stack_counter.types import View


@dataclass(frozen=True)
class PromptedSegmenterSettings:
    """The size of images; chosen.

    Attributes:
        max_side_px: longest side of the images that are labelled, pixels; larger ones are resized
            before, and their labels after.
    """

    max_side_px: int = 640


SETTINGS = PromptedSegmenterSettings()


class PromptedSegmenter:
    """Labels views by colour models and poses, and by depth where all views have it."""

    def __init__(self, config: ReconstructorConfig):
        """Keeps the settings.

        Args:
            config: settings of the scan; a configured region of interest is used as given.
        """
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
        # Resize views and marks.
        small_views = [_shrink_view(view) for view in views]
        full, small = views[0].intrinsics, small_views[0].intrinsics
        small_prompts = prompts.scaled(np.array([small.width / full.width,
                                                 small.height / full.height]))
        # Choose how labels are carried to other views.
        carrier: DepthCarrier | OutlineCarrier
        if all(view.depth is not None for view in views):
            region = find_region(list(views), self._config)
            carrier = DepthCarrier(region, prompts.with_container)
        else:
            area = find_marked_area(small_prompts, (small.height, small.width))
            carrier = OutlineCarrier(small_views, area, prompts.with_container)
        # Label the small views; enlarge the labels.
        probabilities = _estimate_probabilities(small_views, carrier, small_prompts)
        return [_to_label_image(p, view) for p, view in zip(probabilities, views)]


def check_views(views: Sequence[View], prompts: Prompts) -> None:
    """Refuses views and prompts that no prompted segmenter can label.

    Raises:
        PromptError: the prompts do not fit the first view.
        ViewError: reason `no_color`.
    """
    for view in views:
        if view.color is None:
            raise ViewError("no_color", "the view has no colour image; expected one")
    prompts.check(views[0].intrinsics.width, views[0].intrinsics.height)


def _estimate_probabilities(views: list[View], carrier: DepthCarrier | OutlineCarrier,
                            prompts: Prompts) -> list[np.ndarray]:
    """Returns the (3, h, w) float32 class probabilities of every view.

    Args:
        views: resized views with colour.
        carrier: votes or hulls of the labelled views; every view is added to it.
        prompts: marks in pixels of `views[0]`.
    """
    colors = [view.color for view in views if view.color is not None]
    color_bins = [compute_color_bins(color) for color in colors]
    color_models = ColorModels()
    # Label the first view by prompts, and fit the colour models to it.
    first_prior = compute_prompted_prior(carrier.background(views[0]), prompts)
    probabilities = [label_first_view(colors[0], color_bins[0], first_prior, color_models)]
    carrier.add(views[0], probabilities[0])
    for view, color, bins in list(zip(views, colors, color_bins))[1:]:
        # Label by the carried prior, colours and neighbours.
        prior = np.maximum(carrier.prior(view), RULED_OUT)
        p = smooth_to_probabilities(np.log(prior) + color_models.log_likelihood(bins), color)
        probabilities.append(p)
        # Update the colour models and the carrier.
        color_models.add_image(bins, p)
        carrier.add(view, p)
    return probabilities


def _shrink_view(view: View) -> View:
    """Returns a view whose image is at most `max_side_px` long, without labels if resized."""
    k = view.intrinsics
    scale = min(1.0, SETTINGS.max_side_px / max(k.width, k.height))
    if scale == 1 or view.color is None:
        return view
    # Scale the calibration; pixel centres lie on whole numbers.
    width, height = round(k.width * scale), round(k.height * scale)
    x, y = width / k.width, height / k.height
    intrinsics = replace(k, width=width, height=height, fx=k.fx * x, fy=k.fy * y,
                         cx=(k.cx + 0.5) * x - 0.5, cy=(k.cy + 0.5) * y - 0.5)
    # Average colours, but pick depths: a mean of two surfaces lies on neither.
    color = cv2.resize(view.color, (width, height), interpolation=cv2.INTER_AREA)
    depth = None if view.depth is None else cv2.resize(
        view.depth, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
    return replace(view, intrinsics=intrinsics, labels=None, color=color, depth=depth)


def _to_label_image(probabilities: np.ndarray, view: View) -> np.ndarray:
    """Returns the (h, w) uint8 label image of the full view from (3, n, m) probabilities."""
    k = view.intrinsics
    large = [cv2.resize(p, (k.width, k.height), interpolation=cv2.INTER_LINEAR)
             for p in probabilities]
    return np.argmax(large, axis=0).astype(np.uint8)
