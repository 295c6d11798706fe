# SPDX-License-Identifier: Apache-2.0
"""The label images of a scan, by the settings `segmenter`, `prompts` and `sam2_weights`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ConfigError, ViewError
from stack_counter.segmentation.prompted.segmenter import PromptedSegmenter
from stack_counter.segmentation.prompts import PromptError, Prompts, read_prompts
from stack_counter.types import UNLABELLED, UNSEEN, View

_PROMPTED_KINDS = ("prompted", "sam2")


class ScanSegmenter(Protocol):
    """Labels all views of a scan from prompts in the first of them."""

    def segment_views(self, views: Sequence[View], prompts: Prompts) -> list[np.ndarray]:
        """Returns (h, w) uint8 label images (0, 1, 2), one for each view."""
        ...


class ScanLabels:
    """Checks what the views of one scan must have, and gives them their label images."""

    def __init__(self, config: ReconstructorConfig):
        """Reads prompts and weights.

        Raises:
            ConfigError: the settings do not fit each other.
            PromptError: no or bad prompts.
            WeightsError: no or bad SAM 2 weights.
        """
        self._kind = "prompted" if config.segmenter == "auto" and config.prompts \
            else config.segmenter
        if self._kind in _PROMPTED_KINDS and not config.prompts:
            raise ConfigError(f"segmenter is '{config.segmenter}' and prompts is empty; expected "
                              "a prompts file")
        if config.prompts and self._kind not in _PROMPTED_KINDS:
            raise ConfigError(f"prompts is set and segmenter is '{config.segmenter}'; expected "
                              "auto, prompted or sam2")
        self._first: View | None = None  # not cropped: prompts are its pixels
        self._prompts = read_prompts(config.prompts) if config.prompts else None
        self._segmenter: ScanSegmenter | None = None
        if self._prompts is not None:
            self._segmenter = _load_sam2(config) if self._kind == "sam2" \
                else PromptedSegmenter(config)

    @property
    def given_with_views(self) -> bool:
        """Whether the views' own label images are used even where there is depth."""
        return self._segmenter is not None or self._kind == "labels"

    def start(self) -> None:
        """Starts a scan: forgets the first view of the last one."""
        self._first = None

    def check_view(self, view: View) -> None:
        """Refuses a view that cannot be labelled, and keeps the first one for its prompts.

        Args:
            view: the next of the scan, rectified and not yet cropped.

        Raises:
            ViewError: the view lacks what the segmenter works on: reason `no_color`, `no_labels`
                or `no_depth`; or `bad_prompts`, if it is the first and the prompts do not fit it.
        """
        if self._prompts is not None:
            if view.color is None:
                raise ViewError("no_color", "no colour image; expected one to label by prompts")
            if self._first is None:
                try:
                    self._prompts.check(view.intrinsics.width, view.intrinsics.height)
                except PromptError as error:
                    raise ViewError("bad_prompts", str(error)) from error
                self._first = view
        elif self._kind == "labels" and not _is_labelled(view):
            raise ViewError("no_labels", "the view has no label image; expected one")
        elif self._kind == "geometric" and view.depth is None:
            raise ViewError("no_depth", "the view has no depth image; expected one")
        elif view.depth is None and not _is_labelled(view):
            raise ViewError("no_depth", "neither depth nor label image; expected one of them, or "
                                        "prompts")

    def label(self, views: list[View]) -> list[View]:
        """Returns the views with label images from the prompts; unchanged if there are none.

        Args:
            views: those that were checked, in order; they may be cropped since.

        Raises:
            ScanError: no support plane in depth views; or no depth and one direction of sight.
        """
        if self._segmenter is None or self._prompts is None or self._first is None:
            return views
        # Prompts are pixels of the whole first view: where it is cropped now, the whole one goes
        # ahead of all.
        ahead = [] if views[0].color is self._first.color else [self._first]
        labels = self._segmenter.segment_views([*ahead, *views], self._prompts)[len(ahead):]
        return [replace(view, labels=_without_unseen(image, view))
                for view, image in zip(views, labels)]


def _is_labelled(view: View) -> bool:
    """Whether a view has labels, and not only pixels that are masked out."""
    return view.labels is not None and not np.any(view.labels == UNLABELLED)


def _without_unseen(labels: np.ndarray, view: View) -> np.ndarray:
    """The (h, w) uint8 labels of a view, without those of pixels that it leaves out."""
    if view.labels is None:
        return labels
    return np.where(view.labels == UNSEEN, np.uint8(UNSEEN), labels)


def _load_sam2(config: ReconstructorConfig) -> ScanSegmenter:
    """Loads the SAM 2 weights that the settings name.

    Raises:
        ConfigError: the settings name none.
        WeightsError: they are missing or damaged.
    """
    if not config.sam2_weights:
        raise ConfigError("segmenter is 'sam2' and sam2_weights is empty; expected a folder with "
                          "a SAM 2 video model")
    from stack_counter.segmentation.sam2 import Sam2Segmenter  # torch takes seconds

    return Sam2Segmenter(Path(config.sam2_weights))
