# SPDX-License-Identifier: Apache-2.0
"""Turns a nerfstudio scene (transforms.json, pictures, depth, masks, labels) into a bag."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import tee
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stack_counter.bag.nerfstudio.images import (
    DEPTH_SUFFIXES,
    PICTURE_SUFFIXES,
    find_file,
    masks_are_labels,
    read_cutouts,
    read_depth,
    read_grey,
    read_jpeg,
    read_mask,
)
from stack_counter.bag.nerfstudio.stacking import (
    CONTAINER_FOLDER,
    PARTS_FOLDER,
    SceneFacts,
    read_facts,
)
from stack_counter.bag.nerfstudio.transforms import (
    Frame,
    depth_unit,
    key_of_colmap,
    position_scale,
    read_frames,
    read_intrinsics,
    read_pose,
    stated_size,
)
from stack_counter.bag.writer import write_bag
from stack_counter.errors import BagError
from stack_counter.fusion.upright import find_turn
from stack_counter.types import UNLABELLED, UNSEEN, View

_LOG = logging.getLogger(__name__)
_FRAME = "camera_color_optical_frame"
# Folders with the depth of pictures of the same names, where transforms.json names none.
_DEPTH_FOLDERS = ("depths", "depth")
_UNNAMED = "unnamed depth"  # key of frames whose depth comes from such a folder


@dataclass(frozen=True)
class ImportSettings:
    """How a folder of pictures is turned into a recording.

    Attributes:
        step_ns: time between two pictures, which have none of their own, ns; chosen.
        dense_share: least share of a picture's pixels with depth that a depth camera measured;
            depth of matched points has far less. Chosen.
        level_views: number of pictures, from all over the scene, whose depth says what is level;
            chosen.
    """

    step_ns: int = 10**8
    dense_share: float = 0.1
    level_views: int = 24


SETTINGS = ImportSettings()


class _Files(NamedTuple):
    """Files of one picture; None where the scene has no such.

    Attributes:
        picture: colour image.
        depth: depth image.
        mask: 0 where the picture is to be ignored.
        labels: label image.
        parts, container: pictures with a transparent background.
    """

    picture: Path
    depth: Path | None = None
    mask: Path | None = None
    labels: Path | None = None
    parts: Path | None = None
    container: Path | None = None


def import_scene(scene: Path, out: Path) -> str:
    """Writes the bag of a scene.

    Args:
        scene: folder with transforms.json, whose frames name pictures and may name depth
            (`depth_file_path`) and masks (`mask_path`). Label images are in `labels/` under the
            picture's name, or those of 3DC-Real in `obj_seg/` and `box_seg/`.
        out: a new folder.

    Returns:
        A line for people that says what is in the bag.

    Raises:
        FileNotFoundError: there is no such folder.
        BagError: transforms.json or an image is missing or malformed, there are no pictures, the
            poses have no metric scale, or `out` exists.
    """
    frames = _name_unnamed_depth(scene, read_frames(scene))
    found, missing = _find_all(scene, frames)
    if not found:
        example = frames[0]["file_path"] if frames else "images/frame_00001.jpg"
        raise BagError(f"none of the {len(frames)} pictures of {scene} is there with all its "
                       f"files ({'; '.join(_count_lines(missing)) or 'no frames'}); expected "
                       f"some, as {example}: mend file_path, depth_file_path or mask_path of the "
                       "frames in transforms.json, or take the key out")
    facts = read_facts(scene)
    _check_scale(scene, found, facts)
    deep = [item for item in found if item[1].depth is not None]
    turn = find_turn(view for view, _ in _read_views(
        deep[::max(len(deep) // SETTINGS.level_views, 1)]))
    # Read the images while the bag is written: they would not all fit into memory as numbers.
    views, jpegs = tee(_read_views(found, turn))
    write_bag(out, (view for view, _ in views), jpegs=(jpeg for _, jpeg in jpegs))
    if facts.parts:
        (out / "truth.json").write_text(json.dumps({"count": facts.parts}) + "\n")
    return _describe(out, found, missing, facts, turn)


def _name_unnamed_depth(scene: Path, frames: list[Frame]) -> list[Frame]:
    """Frames with the depth that lies in a folder of that name where none of them names any."""
    folder = next((name for name in _DEPTH_FOLDERS if (scene / name).is_dir()), "")
    if not folder or any("depth_file_path" in frame for frame in frames):
        return frames
    return [{**frame, _UNNAMED: folder,
             "depth_file_path": f"{folder}/{Path(frame['file_path']).name}"} for frame in frames]


def _find_all(scene: Path, frames: list[Frame]
              ) -> tuple[list[tuple[Frame, _Files]], Counter[str]]:
    """The frames whose files are all there, and how many lack one, by its kind."""
    found, missing = [], Counter[str]()
    for frame in frames:
        try:
            found.append((frame, _find_files(scene, frame)))
        except _MissingFile as error:
            missing[error.kind] += 1
            _LOG.warning("%s; skipped", error)
    # What stands under mask_path may be labels, which are told by all of them together.
    masks = [files.mask for _, files in found if files.mask is not None]
    if masks and masks_are_labels(masks):
        found = [(frame, files._replace(mask=None, labels=files.mask or files.labels))
                 for frame, files in found]
    return found, missing


class _MissingFile(Exception):
    """A file that a frame needs is not there; `kind` names what it would have been."""

    def __init__(self, kind: str, path: Path):
        super().__init__(f"{path} is missing")
        self.kind = kind


def _find_files(scene: Path, frame: Frame) -> _Files:
    """Finds the files of one picture.

    Raises:
        _MissingFile: one that the frame names, or a cutout of a scene that has such, is missing.
    """
    def find(kind: str, name: object, suffixes: tuple[str, ...]) -> Path:
        path = find_file(scene, str(name), suffixes)
        if path is None:
            raise _MissingFile(kind, scene / str(name))
        return path

    picture = find("pictures", frame["file_path"], PICTURE_SUFFIXES)
    files = _Files(picture)
    if depth := frame.get("depth_file_path"):
        files = files._replace(depth=find("depth images", depth, DEPTH_SUFFIXES))
    if mask := frame.get("mask_path"):
        files = files._replace(mask=find("masks", mask, PICTURE_SUFFIXES))
    labels = scene / "labels" / f"{picture.stem}.png"
    if labels.is_file():
        return files._replace(labels=labels)
    if (scene / PARTS_FOLDER).is_dir():
        files = files._replace(
            parts=find("cutouts", f"{PARTS_FOLDER}/{picture.stem}.png", (".png",)))
        if (scene / CONTAINER_FOLDER).is_dir():
            files = files._replace(
                container=find("cutouts", f"{CONTAINER_FOLDER}/{picture.stem}.png", (".png",)))
    return files


def _check_scale(scene: Path, found: list[tuple[Frame, _Files]], facts: SceneFacts) -> None:
    """Refuses poses of COLMAP, whose unit is any length, unless something says it is the metre.

    Depth that a camera measured would disagree with poses of another scale, and is checked later.

    Raises:
        BagError: nothing says so.
    """
    first, files = found[0]
    if not key_of_colmap(first) or "applied_scale" in first or facts.unit_volume_cm3:
        return
    if files.depth is not None:
        view, _ = next(_read_views(found[:1]))
        if np.mean(np.asarray(view.depth) > 0) >= SETTINGS.dense_share:
            return
    raise BagError(f"{scene}: the poses are COLMAP's ({key_of_colmap(first)}), whose unit is any "
                   "length; expected applied_scale in transforms.json: a length in their unit "
                   "over the same length in metres, 1.0 where they are metres")


def _read_views(found: list[tuple[Frame, _Files]], turn: np.ndarray = np.eye(4)
                ) -> Iterator[tuple[View, bytes]]:
    """Yields the views, without their colour, and their JPEG files.

    Args:
        found: the frames with their files.
        turn: (4, 4) pose of the scene's world in the one of the views.

    Raises:
        BagError: an image or a calibration cannot be used.
    """
    for number, (frame, files) in enumerate(found, 1):
        jpeg, size = read_jpeg(files.picture, stated_size(frame))
        view = View(number * SETTINGS.step_ns, read_intrinsics(frame, *size),
                    turn @ read_pose(frame), camera=_FRAME, labels=_read_labels(files, size))
        if files.depth is not None:
            view = replace(view, depth=_read_depth(frame, files.depth, size))
        if files.mask is not None:
            view = _leave_out(view, read_mask(files.mask, size))
        yield view, jpeg


def _read_depth(frame: Frame, path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) float32 depth of a picture, metres.

    Raises:
        BagError: it cannot be used.
    """
    try:
        return read_depth(path, size, depth_unit(frame))
    except BagError as error:
        if folder := frame.get(_UNNAMED):
            raise BagError(f"{error}; rename {folder}/, which transforms.json does not name, if "
                           "it holds no depth") from error
        raise


def _read_labels(files: _Files, size: tuple[int, int]) -> np.ndarray | None:
    """(h, w) uint8 label image of a picture; None where there is none."""
    if files.labels is not None:
        return read_grey(files.labels, size)
    if files.parts is not None:
        return read_cutouts(files.parts, files.container, size)
    return None


def _leave_out(view: View, mask: np.ndarray) -> View:
    """The view with nothing measured or labelled where a (h, w) bool mask is False."""
    labels = view.labels
    if labels is None and view.depth is None:  # so that labels by prompts know the mask
        labels = np.full(mask.shape, UNLABELLED, np.uint8)
    return replace(
        view, labels=None if labels is None else np.where(mask, labels, UNSEEN).astype(np.uint8),
        depth=None if view.depth is None else np.where(mask, view.depth, np.float32(0)))


def _describe(out: Path, found: list[tuple[Frame, _Files]], missing: Counter[str],
              facts: SceneFacts, turn: np.ndarray) -> str:
    """The line that says what is in the bag."""
    every = [files for _, files in found]
    labelled = sum(files.labels is not None or files.parts is not None for files in every)
    line = f"{out}: {len(every)} views, {labelled} with labels"
    folder = found[0][0].get(_UNNAMED)
    depth = f"with depth of {folder}/, which transforms.json does not name" if folder \
        else "with depth"
    for number, text in ((sum(files.depth is not None for files in every), depth),
                         (sum(files.mask is not None for files in every), "masked")):
        line += f", {number} {text}" if number else ""
    line += "".join(f", {text}" for text in _count_lines(missing))
    if (scale := position_scale(found[0][0])) != 1.0:
        line += f"; positions divided by the scale applied, {scale:.6g}"
    if turn[2, 2] < 1:
        angle = float(np.rad2deg(np.arccos(turn[2, 2])))
        line += f"; turned by {angle:.1f} degrees, as its support shows, so that z is up"
    if facts.unit_volume_cm3:
        line += (f"; one part has {facts.unit_volume_cm3:g} cm3: stack-counter replay {out} "
                 f"--unit-volume-cm3 {facts.unit_volume_cm3:g}")
    return line


def _count_lines(missing: Counter[str]) -> list[str]:
    return [f"{number} {kind} missing" for kind, number in missing.items()]
