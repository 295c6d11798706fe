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

_MEAN, _STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])  # ImageNet's
_SHORT_SIDE = 518  # pixels that the model reads


class MonocularDepth:
    """A loaded model."""

    def __init__(self, folder: Path):
        """Loads the weights.

        Raises:
            WeightsError: as `load_local`.
        """
        self._model = load_pretrained(folder, "depth_anything", "DepthAnythingForDepthEstimation",
                                      "a Depth Anything model")
        self._patch = self._model.config.backbone_config.patch_size

    def nearness(self, color: np.ndarray) -> np.ndarray:
        """(h, w) float32 of a (h, w, 3) uint8 RGB picture: 0 farthest to 1 nearest. What the model
        gives is affine in the inverse of depth; no scale is known.
        """
        height, width = color.shape[:2]
        scale = _SHORT_SIDE / min(height, width)
        size = [max(round(n * scale / self._patch), 1) * self._patch for n in (width, height)]
        small = (cv2.resize(color, size, interpolation=cv2.INTER_CUBIC) / 255 - _MEAN) / _STD
        pixels = torch.from_numpy(np.moveaxis(small, -1, 0)[None]).float()
        with torch.inference_mode():
            inverse = self._model(pixel_values=pixels).predicted_depth[0].float().numpy()
        inverse = cv2.resize(inverse, (width, height), interpolation=cv2.INTER_LINEAR)
        low, high = float(inverse.min()), float(inverse.max())
        return (inverse - low) / max(high - low, 1e-9)
