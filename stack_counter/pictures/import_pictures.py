# SPDX-License-Identifier: Apache-2.0
"""Pictures without poses become a bag, on one page: `import PICTURES OUT --reference ...`.

The bag's world is in metres, z up. Label images are taken along; without them a count takes
marks in the first picture (`replay --prompts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.bag.writer import write_bag
from stack_counter.errors import BagError
from stack_counter.fusion.upright import UprightPose, find_upright_pose
from stack_counter.pictures.folder import (
    Picture,
    find_pictures,
    read_jpeg,
    read_labels,
    read_pixels,
)
from stack_counter.pictures.reference import parse_reference
from stack_counter.pictures.scale import Scale, measure_scale
from stack_counter.pictures.structure_from_motion import Camera, PosedPictures, find_poses, listed
from stack_counter.pictures.targets import find_targets
from stack_counter.types import View

_FRAME = "camera_color_optical_frame"


@dataclass(frozen=True)
class ImportSettings:
    """How pictures become a recording.

    Attributes:
        step_ns: time between two pictures, which need not have one of their own, ns; chosen.
        min_distance_m, max_distance_m: between which the cameras must be from the scene in the
            median, m; chosen: another one is a length in a wrong unit.
    """

    step_ns: int = 10**8
    min_distance_m: float = 0.03
    max_distance_m: float = 10.0


SETTINGS = ImportSettings()


def import_pictures(folder: Path, out: Path, references: Sequence[str]) -> str:
    """Writes the bag of a folder of pictures.

    Args:
        folder: of the pictures, or with them in `images/`; label images in `labels/NAME.png`.
        out: a new folder.
        references: what gives the scale, at least one; see `reference.parse_reference`.

    Returns:
        Lines for people that say what is in the bag, and how exact its scale is.

    Raises:
        FileNotFoundError: there is no such folder.
        ConfigError: a reference cannot be understood, or libraries are missing.
        BagError: `out` exists, too few pictures register, or no reference gives a scale.
    """
    if out.exists():
        raise BagError(f"{out} exists; expected a new path")
    # 1. What the pictures show of the references: a mistake is named before the long work.
    parsed = [parse_reference(text) for text in references]
    pictures = find_pictures(folder)
    by_name = {picture.name: picture for picture in pictures}

    def read_gray(name: str) -> np.ndarray:
        return cv2.cvtColor(read_pixels(by_name[name].path), cv2.COLOR_RGB2GRAY)

    sizes = {picture.name: (picture.width, picture.height) for picture in pictures}
    targets = [(reference, find_targets(reference, sizes, read_gray)) for reference in parsed]
    # 2. Poses and calibration, without scale; then the scale, and which way is up.
    posed = find_poses(pictures, read_gray)
    scale = measure_scale(targets, posed.cameras)
    _check_distance(posed, scale)
    upright = find_upright_pose(posed.points, np.array(
        [camera.T_world_camera for camera in posed.cameras.values()]))
    # 3. The bag.
    registered = [by_name[name] for name in posed.cameras]
    views = [_make_view(picture, posed.cameras[picture.name], scale, upright,
                        (i + 1) * SETTINGS.step_ns) for i, picture in enumerate(registered)]
    write_bag(out, views, jpegs=[read_jpeg(picture) for picture in registered],
              scale_std=scale.relative_std)
    return _describe(out, views, registered, posed, scale, upright)


def _check_distance(posed: PosedPictures, scale: Scale) -> None:
    """Raises BagError: the cameras are so near or far that a length must be in a wrong unit."""
    centers = np.array([camera.T_world_camera[:3, 3] for camera in posed.cameras.values()])
    distances = np.linalg.norm(centers - np.median(posed.points, axis=0), axis=1)
    distance = scale.metres * float(np.median(distances))
    if not SETTINGS.min_distance_m <= distance <= SETTINGS.max_distance_m:
        raise BagError(f"by the references the pictures are taken from {distance:.3g} m; expected "
                       f"{SETTINGS.min_distance_m} to {SETTINGS.max_distance_m:g} m: give their "
                       "lengths in metres")


def _make_view(picture: Picture, camera: Camera, scale: Scale, upright: UprightPose,
               stamp_ns: int) -> View:
    T = upright.T_upright_world @ camera.T_world_camera
    return View(stamp_ns, camera.intrinsics, geometry.pose(T[:3, :3], scale.metres * T[:3, 3]),
                labels=read_labels(picture), camera=_FRAME)


def _describe(out: Path, views: Sequence[View], pictures: Sequence[Picture],
              posed: PosedPictures, scale: Scale, upright: UprightPose) -> str:
    """Lines for people."""
    count, lost = len(pictures), len(posed.unregistered)
    labelled = sum(view.labels is not None for view in views)
    focals = sorted({round(view.intrinsics.fx) for view in views})
    lines = [f"{out}: {count} views, {labelled} with labels; {count} of {count + lost} pictures "
             f"registered" + (f", not {listed(posed.unregistered)}" if lost else ""),
             f"focal length {', '.join(map(str, focals))} pixels; scale within "
             f"{scale.relative_std:.1%}, which adds {3 * scale.relative_std:.1%} to V's error",
             f"up: the support plane, with {upright.support_share:.0%} of the places seen"
             if upright.support_share else "up: the pictures' own, on average: no support plane "
             "was found; turn phone pictures upright, or take them over a patterned ground"]
    if labelled < count:
        lines.append(f"{count - labelled} pictures have no label image: to count, mark the parts "
                     f"in {pictures[0].name} (replay --prompts)")
    return "\n".join(lines)
