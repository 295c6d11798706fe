# SPDX-License-Identifier: Apache-2.0
"""The key view of a recording as a colour picture, with the truth of what it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.sim.camera.part_visibility import PartsInView, find_parts_in_view
from stack_counter.sim.camera.recording import CAMERA, arc_poses, scaled_camera
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.types import PARTS, Intrinsics

_SEARCH_WIDTH_PX = 160  # of the label images in which part pixels are counted; chosen


@dataclass(frozen=True, eq=False)
class KeyPicture:
    """The picture of a recording that shows the most parts, cropped to them.

    Attributes:
        color: (h, w, 3) uint8 RGB.
        parts: the parts in it.
    """

    color: np.ndarray
    parts: PartsInView

    @property
    def visible_count(self) -> int:
        """Number of parts that count as visible."""
        return len(self.parts.visible)


def picture_key_view(scene: Scene, views: int = 12, seed: int = 0,
                     intrinsics: Intrinsics = CAMERA) -> KeyPicture:
    """Renders the key view in colour; its camera is one of those of `recording.record`.

    Args:
        scene: what is pictured.
        views: number of views on the arc.
        seed: of the arc and the materials, as `record` takes it.
        intrinsics: of the picture that the crop is cut from.

    Raises:
        SceneError: there is no part, or no view shows one.
    """
    if not len(scene.poses):
        raise SceneError(f"scene {scene.index} holds no part; expected one at least")
    renderer, search = Renderer(scene), scaled_camera(_SEARCH_WIDTH_PX)
    poses = arc_poses(*scene.bounds(), views, np.random.default_rng([seed, scene.index, 0xA7]))
    # The view that shows the most parts
    part_pixels = [np.count_nonzero(renderer.render_depth_and_labels(search, T)[1] == PARTS)
                   for T in poses]
    T = poses[int(np.argmax(part_pixels))]
    parts = find_parts_in_view(renderer, scene, intrinsics, T)
    rows, cols = np.nonzero(parts.numbers >= 0)
    if not len(rows):
        raise SceneError(f"scene {scene.index}: none of {views} views shows a part; expected one "
                         "at least")
    # Crop it to them
    crop = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
    color = renderer.render_color(intrinsics, T, seed)
    return KeyPicture(np.ascontiguousarray(color[crop]), parts.cropped(*crop))
