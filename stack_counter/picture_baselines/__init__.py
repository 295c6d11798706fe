# SPDX-License-Identifier: Apache-2.0
"""The methods that the paper compares itself with: each counts from one colour picture.

    baseline = load_baseline("vit_h", [Path("out/pictures/vit_h.safetensors")])
    baseline.guess(Picture("scene", color, "nut", exemplars))

They are for comparison alone; nothing that counts a stack for a user asks them. Their libraries
(torch, transformers) are loaded with the baseline.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stack_counter.errors import WeightsError
from stack_counter.picture_baselines.kinds import KINDS, BaselineKind

if TYPE_CHECKING:
    from stack_counter.picture_baselines.picture import PictureBaseline

__all__ = ["KINDS", "BaselineKind", "load_baseline"]


def load_baseline(name: str, paths: Sequence[Path]) -> PictureBaseline:
    """Loads a baseline from the user's files.

    Args:
        name: key of `KINDS`.
        paths: files and folders that it needs, in the order of `BaselineKind.needs`.

    Raises:
        WeightsError: there are too few or too many of them, or they cannot be loaded.
    """
    kind = KINDS[name]
    if not kind.fewest_paths <= len(paths) <= len(kind.needs):
        raise WeightsError(f"{name} got {len(paths)} paths ({', '.join(map(str, paths))}); "
                           f"expected {', '.join(kind.needs)}")
    if name in ("vit_h", "color"):
        from stack_counter.picture_baselines.picture_net import PictureNetBaseline

        return PictureNetBaseline(name, *paths)
    if name == "bmnet":
        from stack_counter.picture_baselines.bmnet import BMNetBaseline

        return BMNetBaseline(*paths)
    if name == "sam_clip":
        from stack_counter.picture_baselines.sam_clip import SamClip

        return SamClip(*paths)
    if name == "vlm":
        from stack_counter.picture_baselines.vision_language import VisionLanguage

        return VisionLanguage(*paths)
    from stack_counter.picture_baselines.people import People

    return People(*paths)
