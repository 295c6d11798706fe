# SPDX-License-Identifier: Apache-2.0
"""Turns a nerfstudio folder (transforms.json, images, optional label images) into a bag."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stack_counter.bag.writer import write_bag
from stack_counter.errors import BagError
from stack_counter.types import Intrinsics, View

_LOG = logging.getLogger(__name__)
_FRAME = "camera_color_optical_frame"
# Distortion model and keys of its coefficients, by nerfstudio's camera model.
_CAMERA_MODELS = {"OPENCV": ("plumb_bob", ("k1", "k2", "p1", "p2", "k3")), "PINHOLE": ("", ()),
                  "SIMPLE_PINHOLE": ("", ()),
                  "OPENCV_FISHEYE": ("equidistant", ("k1", "k2", "k3", "k4"))}
# From the optical frame (y down, z forward) to nerfstudio's camera (y up, z back).
_T_CAMERA_OPTICAL = np.diag([1.0, -1, -1, 1])


@dataclass(frozen=True)
class ImportSettings:
    """How a folder of pictures is turned into a recording.

    Attributes:
        step_ns: time between two pictures, which have none of their own, ns; chosen.
        jpeg_quality: of pictures that are no JPEG files; chosen.
    """

    step_ns: int = 10**8
    jpeg_quality: int = 95


SETTINGS = ImportSettings()


def import_scene(scene: Path, out: Path) -> str:
    """Writes the bag of a scene.

    Args:
        scene: folder with transforms.json; label images by the frame's `mask_path`, else in
            `labels/` under the picture's name.
        out: a new folder.

    Returns:
        A line for people that says what is in the bag.

    Raises:
        FileNotFoundError: there is no such folder.
        BagError: transforms.json is missing or malformed, there are no pictures, or `out` exists.
    """
    document, frames = _read_transforms(scene)
    # Make a view of each picture that is there.
    views: list[View] = []
    jpegs: list[bytes] = []
    missing = 0
    for frame in frames:
        picture = scene / frame["file_path"]
        if not picture.is_file():
            missing += 1
            _LOG.warning("picture %s is missing; skipped", picture)
            continue
        stamp_ns = (len(views) + 1) * SETTINGS.step_ns
        views.append(_make_view(scene, document, frame, picture, stamp_ns))
        jpegs.append(_read_jpeg(picture))
    if not views:
        raise BagError(f"none of the {len(frames)} pictures of {scene} is there; expected some")
    write_bag(out, views, jpegs=jpegs)
    labelled = sum(view.labels is not None for view in views)
    return (f"{out}: {len(views)} views, {labelled} with labels"
            + (f", {missing} pictures missing" if missing else ""))


def _read_transforms(scene: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The document transforms.json and its frames, sorted by path."""
    if not scene.exists():
        raise FileNotFoundError(f"no scene {scene}; expected a folder with transforms.json")
    try:
        document = json.loads((scene / "transforms.json").read_text())
        return document, sorted(document["frames"], key=lambda frame: frame["file_path"])
    except (FileNotFoundError, NotADirectoryError) as error:
        raise BagError(f"no transforms.json in {scene}; expected a nerfstudio scene") from error
    except (ValueError, KeyError, TypeError) as error:
        raise BagError(f"{scene / 'transforms.json'} is malformed at {error}; expected "
                       "nerfstudio's keys") from error


def _make_view(scene: Path, document: dict[str, Any], frame: dict[str, Any], picture: Path,
               stamp_ns: int) -> View:
    try:
        T = np.array(frame["transform_matrix"], float)
        if T.shape != (4, 4):
            raise ValueError(f"a transform_matrix of shape {T.shape}")
        intrinsics = _parse_intrinsics({**document, **frame})
    except (KeyError, TypeError, ValueError) as error:
        raise BagError(f"{frame.get('file_path')} lacks {error}; expected intrinsics and a 4 x 4 "
                       "transform_matrix") from error
    return View(stamp_ns, intrinsics, T @ _T_CAMERA_OPTICAL, camera=_FRAME,
                labels=_read_labels(scene, frame, picture))


def _parse_intrinsics(values: dict[str, Any]) -> Intrinsics:
    kind = values.get("camera_model", "OPENCV")
    if kind not in _CAMERA_MODELS:
        raise ValueError(f"a known camera_model ('{kind}'; one of {sorted(_CAMERA_MODELS)})")
    model, names = _CAMERA_MODELS[kind]
    return Intrinsics(int(values["w"]), int(values["h"]), float(values["fl_x"]),
                      float(values["fl_y"]), float(values["cx"]), float(values["cy"]), model,
                      tuple(float(values.get(name, 0.0)) for name in names))


def _read_labels(scene: Path, frame: dict[str, Any], picture: Path) -> np.ndarray | None:
    """(h, w) uint8 label image of a picture; None where there is none."""
    named = frame.get("mask_path")
    path = scene / named if named else scene / "labels" / f"{picture.stem}.png"
    labels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    if named and labels is None:
        _LOG.warning("label image %s is missing", path)
    return labels


def _read_jpeg(picture: Path) -> bytes:
    """Content of a JPEG file; of another picture, what it is as a JPEG."""
    if picture.suffix.lower() in (".jpg", ".jpeg"):
        return picture.read_bytes()
    image = cv2.imread(str(picture), cv2.IMREAD_COLOR)
    if image is None:
        raise BagError(f"{picture} does not decode; expected a picture")
    options = [cv2.IMWRITE_JPEG_QUALITY, SETTINGS.jpeg_quality]
    return cv2.imencode(".jpg", image, options)[1].tobytes()
