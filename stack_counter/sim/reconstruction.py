# SPDX-License-Identifier: Apache-2.0
"""A scene through the whole run time: recorded with noise, fused and measured."""

from __future__ import annotations

from dataclasses import replace

from stack_counter.config import ReconstructorConfig
from stack_counter.pipeline import StackCounter
from stack_counter.sim.camera.recording import (
    CAMERA,
    record,
    record_fixed_camera,
    scaled_camera,
)
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import StackVolume


def reconstruct(scene: Scene, seed: int = 0, views: int = 12) -> StackVolume:
    """Measures V from a noisy recording of a scene, with the default settings.

    Args:
        scene: what is recorded.
        seed: seed of the camera's arc and of the noise.
        views: number of views on the arc.

    Raises:
        StackCounterError: the scan is refused.
    """
    stack = StackCounter(ReconstructorConfig(), scene.truth.unit_volume)
    for view in record(scene, views, seed, color=False):
        stack.add_view(view)
    return stack.volume()


def reconstruct_from_above(scene: Scene) -> StackVolume:
    """Measures V from one noisy view of a fixed camera, as the continuous mode does at first.

    Raises:
        StackCounterError: the scan is refused.
    """
    stack = StackCounter(ReconstructorConfig(live=True), scene.truth.unit_volume)
    stack.add_view(record_fixed_camera([scene], color=False)[0])
    return stack.volume()


def reconstruct_from_pictures(scene: Scene, views: int = 24, width_px: int = CAMERA.width
                              ) -> StackVolume:
    """Measures V from pictures with labels, without depth, with the default settings.

    Args:
        scene: what is recorded.
        views: number of views on the arc.
        width_px: width of the pictures, which show the same whatever it is.

    Raises:
        StackCounterError: the scan is refused.
    """
    stack = StackCounter(ReconstructorConfig(), scene.truth.unit_volume)
    for view in record(scene, views, intrinsics=scaled_camera(width_px), labels=True):
        stack.add_view(replace(view, depth=None))
    return stack.volume()
