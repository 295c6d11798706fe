# SPDX-License-Identifier: Apache-2.0
"""Depth of one picture by Depth Anything V2, for a key view in colour only.

The weights are the user's: a local folder, as `transformers` saves a
`DepthAnythingForDepthEstimation`. Source: Yang et al., "Depth Anything V2" (2024).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from stack_counter.pretrained import load_pretrained

_IMAGENET_MEAN, _IMAGENET_STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
_SHORT_SIDE_PX = 518
_EPSILON = 1e-9


class MonocularDepth:
    """A loaded Depth Anything model."""

    def __init__(self, folder: Path):
        """Loads the weights.

        Raises:
            WeightsError: the folder is missing, damaged or of another model, or `transformers` is
                not installed.
        """
        self._model = load_pretrained(folder, "depth_anything", "DepthAnythingForDepthEstimation",
                                      "a Depth Anything model")
        self._patch = self._model.config.backbone_config.patch_size

    def estimate_nearness(self, color: np.ndarray) -> np.ndarray:
        """Estimates how near each pixel is, up to an unknown scale.

        Args:
            color: (h, w, 3) uint8 RGB.

        Returns:
            (h, w) float32, 0 farthest to 1 nearest; affine in the inverse of depth.
        """
        # Resize the short side to what the model was trained with, in whole patches.
        height, width = color.shape[:2]
        scale = _SHORT_SIDE_PX / min(height, width)
        size = [max(round(n * scale / self._patch), 1) * self._patch for n in (width, height)]
        resized = cv2.resize(color, size, interpolation=cv2.INTER_CUBIC) / 255
        normalized = (resized - _IMAGENET_MEAN) / _IMAGENET_STD
        # Predict inverse depth and bring it back to the picture's size.
        pixels = torch.from_numpy(np.moveaxis(normalized, -1, 0)[None]).float()  # (1, 3, h, w)
        with torch.inference_mode():
            inverse = self._model(pixel_values=pixels).predicted_depth[0].float().numpy()
        inverse = cv2.resize(inverse, (width, height), interpolation=cv2.INTER_LINEAR)
        # Normalise.
        low, high = float(inverse.min()), float(inverse.max())
        return (inverse - low) / max(high - low, _EPSILON)
