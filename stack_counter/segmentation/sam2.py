# SPDX-License-Identifier: Apache-2.0
"""Labels by SAM 2: the prompts of the first view, followed through the views as through a video.

    labels = Sam2Segmenter(folder).segment_views(views, read_prompts(path))

The weights are the user's: a local folder with `config.json` and safetensors, as
`transformers` saves a `Sam2VideoModel`. Nothing is downloaded.

Source: Ravi et al., "SAM 2: Segment Anything in Images and Videos" (2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from stack_counter.pretrained import load_pretrained
from stack_counter.segmentation.prompted.segmenter import check_views
from stack_counter.segmentation.prompts import Prompts
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, View

# Mean and standard deviation of the colours that SAM 2 was trained with (ImageNet's).
_MEAN, _STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
# Kinds of points, by SAM 2's numbers.
_OFF, _ON, _LOW_CORNER, _HIGH_CORNER = 0, 1, 2, 3


class Sam2Segmenter:
    """Labels the views of a scan by a SAM 2 video model."""

    def __init__(self, folder: Path):
        """Loads the weights.

        Args:
            folder: with `config.json` and safetensors.

        Raises:
            WeightsError: folder or safetensors missing, damaged, of another model or incomplete;
                or `transformers` is not installed.
        """
        self._model = load_pretrained(
            folder, "sam2_video", "Sam2VideoModel", "a SAM 2 video model"
        )
        from transformers import Sam2VideoInferenceSession

        self._session = Sam2VideoInferenceSession
        size = self._model.config.vision_config.backbone_config.image_size
        self._height, self._width = np.broadcast_to(size, 2).tolist()

    def segment_views(self, views: Sequence[View], prompts: Prompts) -> list[np.ndarray]:
        """Labels every view of a scan; views that follow one another should look alike.

        Args:
            views: rectified views with colour.
            prompts: marks in `views[0]`.

        Returns:
            (h, w) uint8 label images (0, 1, 2), one for each view; where both classes claim a
            pixel it is parts, as a container's mask takes in what it holds.

        Raises:
            PromptError: the prompts do not fit the first view.
            ViewError: reason `no_color`.
        """
        if not views:
            return []
        check_views(views, prompts)
        session = self._session(video=torch.stack([self._pixels(view) for view in views]),
                                video_height=views[0].intrinsics.height,
                                video_width=views[0].intrinsics.width, dtype=torch.float32)
        self._add_prompts(session, prompts, views[0])
        labels = []
        with torch.inference_mode():
            for frame in self._model.propagate_in_video_iterator(session, start_frame_idx=0):
                masks = {number: frame.pred_masks[i, 0].float().numpy()
                         for i, number in enumerate(frame.object_ids)}
                labels.append(_label_image(masks, views[frame.frame_idx]))
        return labels

    def _pixels(self, view: View) -> torch.Tensor:
        """Returns (3, height, width) float32 of the model's size, colours as in its training."""
        assert view.color is not None  # for the type checker: `check_views`
        shrinks = view.color.shape[0] > self._height
        small = cv2.resize(view.color, (self._width, self._height), interpolation=cv2.INTER_AREA
                           if shrinks else cv2.INTER_LINEAR)
        return torch.from_numpy(np.moveaxis((small / 255 - _MEAN) / _STD, -1, 0)).float()

    def _add_prompts(self, session: Any, prompts: Prompts, first: View) -> None:
        """Adds the marks in the first view to a session; marks of one class exclude the others."""
        scale = np.array([self._width / first.intrinsics.width,
                          self._height / first.intrinsics.height])
        others = [prompts.background_points, prompts.container_points]
        for number, boxes, points, off in (
                (PARTS, prompts.part_boxes, prompts.part_points, np.concatenate(others)),
                (CONTAINER, prompts.container_boxes, prompts.container_points,
                 prompts.background_points)):
            if not len(boxes) + len(points):
                continue
            corners = np.array([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)]) \
                if len(boxes) else np.zeros((0, 2))
            marks = np.concatenate([corners, points, off]) * scale
            kinds = [_LOW_CORNER, _HIGH_CORNER][:len(corners)] + [_ON] * len(points) \
                + [_OFF] * len(off)
            session.add_point_inputs(session.obj_id_to_idx(number), 0, {
                "point_coords": torch.tensor(marks, dtype=torch.float32)[None, None],
                "point_labels": torch.tensor(kinds, dtype=torch.int32)[None, None]})
        session.obj_with_new_inputs = list(session.obj_ids)


def _label_image(masks: dict[int, np.ndarray], view: View) -> np.ndarray:
    """Returns the (h, w) uint8 labels of a view from log odds, (n, m) float32, by class."""
    k = view.intrinsics
    labels = np.full((k.height, k.width), BACKGROUND, np.uint8)
    for number in (CONTAINER, PARTS):
        if number in masks:
            large = cv2.resize(masks[number], (k.width, k.height),
                               interpolation=cv2.INTER_LINEAR)
            labels[large > 0] = number
    return labels

