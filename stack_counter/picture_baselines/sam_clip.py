# SPDX-License-Identifier: Apache-2.0
"""SAM + CLIP: masks of everything in the picture, of which CLIP keeps those that look like parts.

SAM 2 is asked at every point of a grid; masks that it is sure of and that a threshold changes
little are kept once each. What each mask shows is compared by CLIP with texts that describe the
part and texts that describe anything else; the count is the number of masks nearer to the first.

The weights are the user's: local folders as `transformers` saves a `Sam2Model` (or the video model
of the setting `sam2_weights`) and a `CLIPModel` with its tokenizer. Nothing is downloaded.

Source: paper, section 4.2; Kirillov et al., "Segment Anything" (2023), section 5 and appendix B,
for grid, thresholds and suppression; Radford et al., "Learning Transferable Visual Models From
Natural Language Supervision" (2021). The paper does not print its texts; these are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from stack_counter.picture_baselines.picture import Picture, fit_square, normalized
from stack_counter.pretrained import load_pretrained, load_processor, model_type_of


@dataclass(frozen=True)
class SamClipSettings:
    """Which masks are asked for and kept.

    Attributes:
        points_per_side: of the grid. Source: Segment Anything, as the next three.
        least_quality: least IoU that the model expects of a mask.
        least_stability: least IoU of the masks at log odds of plus and minus one.
        largest_box_iou: boxes that overlap more are of the same thing.
        largest_share: masks of more of the picture are not parts; chosen.
        points_at_once: of one run of the decoder; chosen.
        crops_at_once: of one run of CLIP; chosen.
        positive, negative: texts; {part} is the part's name. Chosen.
    """

    points_per_side: int = 32
    least_quality: float = 0.88
    least_stability: float = 0.95
    largest_box_iou: float = 0.7
    largest_share: float = 0.3
    points_at_once: int = 64
    crops_at_once: int = 32
    positive: tuple[str, ...] = ("a photo of a {part}", "a photo of one {part} among many")
    negative: tuple[str, ...] = (
        "a photo of an empty box", "a photo of a table", "a photo of a shadow",
        "a photo of a pile of things", "a photo of the background")


SETTINGS = SamClipSettings()
# Mean and standard deviation of the colours that CLIP was trained with.
_CLIP_MEAN = np.array([0.48145466, 0.4578275, 0.40821073])
_CLIP_STD = np.array([0.26862954, 0.26130258, 0.27577711])


class SamClip:
    """Counts masks that look like the part."""

    def __init__(self, sam_folder: Path, clip_folder: Path):
        """Loads both models.

        Raises:
            WeightsError: a folder is missing, damaged or of another model, or `transformers` is
                not installed.
        """
        # Files of the video model hold those of the model for pictures.
        kind = "sam2_video" if model_type_of(sam_folder, "a SAM 2 model") == "sam2_video" \
            else "sam2"
        self._sam = load_pretrained(sam_folder, kind, "Sam2Model", "a SAM 2 model")
        size = self._sam.config.vision_config.backbone_config.image_size
        self._sam_px = int(np.broadcast_to(size, 2)[0])
        self._clip = load_pretrained(clip_folder, "clip", "CLIPModel", "a CLIP model")
        self._tokenizer = load_processor(clip_folder, "AutoTokenizer", "a CLIP model")

    def guess(self, picture: Picture) -> list[float]:
        """Gives the number of masks that look like the part."""
        masks = self.find_masks(picture.color)
        return [float(np.count_nonzero(self.look_like(picture, masks)))]

    def find_masks(self, color: np.ndarray) -> list[np.ndarray]:
        """Finds (h, w) bool masks of everything in a (h, w, 3) picture, each thing once."""
        side = self._sam_px
        square = fit_square(color, side)
        steps = (np.arange(SETTINGS.points_per_side) + 0.5) / SETTINGS.points_per_side
        rows, cols = color.shape[:2]
        grid = np.stack(np.meshgrid(steps * cols, steps * rows), -1).reshape(-1, 2) - 0.5
        points = torch.from_numpy(square.moved(grid)).float()
        found = []
        with torch.inference_mode():
            embeddings = self._sam.get_image_embeddings(
                torch.from_numpy(normalized(square.color))[None])
            for some in points.split(SETTINGS.points_at_once):
                found.append(_good_masks(self._sam(
                    image_embeddings=embeddings, input_points=some[None, :, None],
                    input_labels=torch.ones(1, len(some), 1, dtype=torch.int32))))
        masks, quality = (np.concatenate(part) for part in zip(*found))
        # Back to the picture's pixels
        x, y = square.offset.astype(int)
        width, height = (round(n * square.scale) for n in (cols, rows))
        return _each_once([cv2.resize(cv2.resize(mask, (side, side))[
            y:y + height, x:x + width], (cols, rows)) > 0 for mask in masks], quality)

    def look_like(self, picture: Picture, masks: list[np.ndarray]) -> np.ndarray:
        """(n,) bool: CLIP finds what a mask shows nearer to the texts of the part."""
        kept = np.zeros(len(masks), bool)
        texts = [text.format(part=picture.part) for text in SETTINGS.positive + SETTINGS.negative]
        tokens = self._tokenizer(texts, padding=True, return_tensors="pt")
        side = self._clip.config.vision_config.image_size
        for first in range(0, len(masks), SETTINGS.crops_at_once):
            some = masks[first:first + SETTINGS.crops_at_once]
            crops = np.stack([fit_square(_cut_out(picture.color, mask), side).color
                              for mask in some])
            with torch.inference_mode():
                logits = self._clip(pixel_values=torch.from_numpy(normalized(
                    crops, _CLIP_MEAN, _CLIP_STD)), **tokens).logits_per_image  # (n, texts)
            shares = torch.softmax(logits, 1)[:, :len(SETTINGS.positive)].sum(1)
            kept[first:first + len(some)] = shares.numpy() > 0.5
        return kept


def _good_masks(output: Any) -> tuple[np.ndarray, np.ndarray]:
    """(n, m, m) float32 log odds and (n,) quality of the masks that are sure and stable."""
    odds = output.pred_masks[0].flatten(0, 1)  # (points * 3, m, m)
    quality = output.iou_scores[0].flatten()
    inner, outer = ((odds > limit).sum((1, 2)) for limit in (1.0, -1.0))
    share = (odds > 0).float().mean((1, 2))
    good = (quality >= SETTINGS.least_quality) & (inner > 0) \
        & (inner >= SETTINGS.least_stability * outer) & (share <= SETTINGS.largest_share)
    return odds[good].float().numpy(), quality[good].float().numpy()


def _each_once(masks: list[np.ndarray], quality: np.ndarray) -> list[np.ndarray]:
    """The best of the masks whose boxes overlap much; empty ones are left out."""
    order = [i for i in np.argsort(-quality, kind="stable") if masks[i].any()]
    kept: list[int] = []
    boxes = {i: _box_of(masks[i]) for i in order}
    for i in order:
        if all(_box_iou(boxes[i], boxes[j]) <= SETTINGS.largest_box_iou for j in kept):
            kept.append(i)
    return [masks[i] for i in kept]


def _box_of(mask: np.ndarray) -> np.ndarray:
    """(4,) x0, y0, x1, y1 around a mask; the last two lie outside."""
    rows, cols = np.nonzero(mask)
    return np.array([cols.min(), rows.min(), cols.max() + 1, rows.max() + 1])


def _box_iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boxes (4,)."""
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    return float(common / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - common))


def _cut_out(color: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """What a mask shows, cropped to it; black beside it."""
    x0, y0, x1, y1 = _box_of(mask)
    return np.where(mask[..., None], color, 0)[y0:y1, x0:x1].astype(np.uint8)
