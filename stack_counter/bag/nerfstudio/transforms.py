# SPDX-License-Identifier: Apache-2.0
"""The file transforms.json: poses and calibrations of a scene's pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.errors import BagError
from stack_counter.types import Intrinsics

_PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_FISHEYE = "OPENCV_FISHEYE"
# Keys of the coefficients, in OpenCV's order.
_COEFFICIENTS = {"plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
                 "equidistant": ("k1", "k2", "k3", "k4")}
# Keys of the coefficients in nerfstudio's list `distortion_params`.
_LISTED = ("k1", "k2", "k3", "k4", "p1", "p2")
# Instant NGP's names of keys -> nerfstudio's.
_OTHER_NAMES = {"depth_path": "depth_file_path", "integer_depth_scale": "depth_unit_scale_factor"}
# From the optical frame (y down, z forward) to nerfstudio's camera (y up, z back).
_T_CAMERA_OPTICAL = np.diag([1.0, -1, -1, 1])
# Largest deviation of a rotation's columns from unit vectors across each other; chosen.
_ROTATION_ERROR = 0.01

# What a folder of another tool or data set holds -> whose it is.
_OTHERS = {"groundtruth.txt": "TUM RGB-D", "scene_camera.json": "BOP", "sparse": "COLMAP",
           "keyframes": "Polycam", "intrinsic": "ScanNet", "metadata": "Record3D"}

Frame = dict[str, Any]  # keys of one picture, on top of those of all pictures


def read_frames(scene: Path) -> list[Frame]:
    """Reads transforms.json.

    Returns:
        The keys of every picture, with those that the file has for all of them, sorted by path.

    Raises:
        FileNotFoundError: there is no such folder.
        BagError: the file is missing or malformed.
    """
    if not scene.exists():
        raise FileNotFoundError(f"no scene {scene}; expected a folder with transforms.json")
    path = scene / "transforms.json"
    try:
        document = json.loads(path.read_text())
        common = {key: value for key, value in document.items() if key != "frames"}
        frames = [_renamed({**common, **frame}) for frame in document["frames"]]
        return sorted(frames, key=lambda frame: frame["file_path"])
    except (FileNotFoundError, NotADirectoryError) as error:
        others = sorted(other.name for other in scene.glob("transforms*.json"))
        tool = next((f", which looks like {tool}'s ({name})" for name, tool in _OTHERS.items()
                     if (scene / name).exists()), "")
        raise BagError(f"no transforms.json in {scene}{tool}; expected a nerfstudio scene"
                       + (f": rename one of {', '.join(others)}" if others else
                          ": write its poses so (docs/pictures.md)" if tool else
                          " (or pictures alone, with --reference)")) from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BagError(f"{path} is malformed at {error}; expected nerfstudio's keys") from error


def _renamed(frame: Frame) -> Frame:
    """The keys of a picture with those of Instant NGP under nerfstudio's names."""
    return {**{name: frame[other] for other, name in _OTHER_NAMES.items() if other in frame},
            **frame, "file_path": str(frame["file_path"]).replace("\\", "/")}


def position_scale(frame: Frame) -> float:
    """Number by which the tool that wrote the file has multiplied all positions.

    Raises:
        BagError: `applied_scale` or `applied_transform` is malformed.
    """
    try:
        scale = float(frame.get("applied_scale", 1.0))
        if "applied_transform" in frame:
            rotation = np.array(frame["applied_transform"], float)[:3, :3]
            scale *= float(np.cbrt(np.abs(np.linalg.det(rotation))))
    except (TypeError, ValueError, OverflowError, IndexError, np.linalg.LinAlgError) as error:
        raise BagError(f"applied_scale or applied_transform is malformed ({error}); expected a "
                       "number above 0 and a 3 x 4 matrix") from error
    if not (np.isfinite(scale) and scale > 0):
        raise BagError(f"applied_scale and applied_transform scale positions by {scale}; expected "
                       "a number above 0")
    return 1.0 if abs(scale - 1) < 1e-6 else scale


def key_of_colmap(frame: Frame) -> str:
    """The key by which a picture's pose is known to be COLMAP's; empty where there is none.

    It is nerfstudio's (`colmap_im_id`) or that of Instant NGP's `colmap2nerf.py` (`sharpness`).
    """
    return next((key for key in ("colmap_im_id", "sharpness") if key in frame), "")


def read_pose(frame: Frame) -> np.ndarray:
    """(4, 4) T_world_camera of a picture's optical frame, metres; a scale applied is undone.

    Raises:
        BagError: no pose, or none of a camera.
    """
    name = frame["file_path"]
    try:
        T = np.array(frame["transform_matrix"], float)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BagError(f"{name} lacks {error}; expected a 4 x 4 transform_matrix") from error
    if T.shape not in ((3, 4), (4, 4)) or not np.isfinite(T).all():
        raise BagError(f"{name} lacks a finite transform_matrix, its shape is {T.shape}; expected "
                       "4 x 4")
    T = np.vstack([T[:3], [0, 0, 0, 1]])
    rotation = T[:3, :3]
    off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if off > _ROTATION_ERROR or np.linalg.det(rotation) < 0:
        raise BagError(f"{name}: the transform_matrix is off a rotation by {off:.3g}; expected "
                       "right-handed axes of length 1: a scale belongs into applied_scale")
    T[:3, 3] /= position_scale(frame)
    return T @ _T_CAMERA_OPTICAL


def stated_size(frame: Frame) -> tuple[int, int] | None:
    """Width and height that a picture's calibration is for, pixels; None: it does not say.

    Raises:
        BagError: they are no numbers.
    """
    try:
        return (int(frame["w"]), int(frame["h"])) if "w" in frame and "h" in frame else None
    except (TypeError, ValueError, OverflowError) as error:
        raise BagError(f"w or h of {frame['file_path']} is malformed ({error}); expected pixels"
                       ) from error


def depth_unit(frame: Frame) -> float | None:
    """Metres in one step of a picture's depth; None where the frame does not say.

    Raises:
        BagError: it is no number.
    """
    unit = frame.get("depth_unit_scale_factor")
    try:
        return None if unit is None else float(unit)
    except (TypeError, ValueError, OverflowError) as error:
        raise BagError(f"depth_unit_scale_factor is {unit!r}; expected metres in one step of "
                       "depth") from error


def read_intrinsics(frame: Frame, width: int, height: int) -> Intrinsics:
    """Calibration of a picture of this size, pixels.

    Raises:
        BagError: the calibration is missing or malformed, is of another kind of camera, or is that
            of pictures of another size.
    """
    name = frame["file_path"]
    model = _distortion_model(frame)
    try:
        stated = stated_size(frame) or (width, height)
        if stated != (width, height):
            raise BagError(f"{name} is {width}x{height} and transforms.json says "
                           f"{stated[0]}x{stated[1]}; expected alike: a calibration holds for "
                           "one size, so take pictures of that, or scale w, h, fl_x, fl_y, cx "
                           "and cy with them")
        fx = _focal_length(frame, "x", width)
        fy = _focal_length(frame, "y", height) or fx
        if not fx or not fy:
            raise BagError(f"{name} lacks fl_x; expected it, or camera_angle_x")
        return Intrinsics(width, height, fx, fy, _principal_point(frame, "cx", width),
                          _principal_point(frame, "cy", height), model,
                          _coefficients(frame, model))
    except (TypeError, ValueError, OverflowError) as error:
        raise BagError(f"{name}: the calibration is malformed ({error}); expected numbers under "
                       "w, h, fl_x, fl_y, cx, cy, k1 ...") from error


def _distortion_model(frame: Frame) -> str:
    kind = _FISHEYE if frame.get("is_fisheye") else frame.get("camera_model", "OPENCV")
    if kind == _FISHEYE:
        return "equidistant"
    if kind in _PERSPECTIVE:
        return "plumb_bob"
    raise BagError(f"camera_model is '{kind}', which is no lens with a focal length; expected one "
                   f"of {', '.join((*_PERSPECTIVE, _FISHEYE))}: cut perspective pictures out of "
                   "it first")


def _focal_length(frame: Frame, axis: str, size: int) -> float:
    """Focal length along x or y, pixels, also from an angle of view; 0 where there is none."""
    if f"fl_{axis}" in frame:
        return float(frame[f"fl_{axis}"])
    angle = float(frame.get(f"camera_angle_{axis}")
                  or np.deg2rad(frame.get(f"{axis}_fov") or 0.0))
    return float(size / 2 / np.tan(angle / 2)) if angle else 0.0


def _principal_point(frame: Frame, key: str, size: int) -> float:
    """Place where the optical axis meets the picture, pixels, whole numbers at pixel centres.

    COLMAP's centres lie on halves; and half the size, where the format's tools put a point that
    they do not measure, is meant to be the middle of the picture.
    """
    point = float(frame.get(key, size / 2))
    return point - 0.5 if key_of_colmap(frame) or point == size / 2 else point


def _coefficients(frame: Frame, model: str) -> tuple[float, ...]:
    values = {**dict(zip(_LISTED, frame.get("distortion_params", ()))), **frame}
    if model == "plumb_bob" and values.get("k4"):
        raise BagError(f"k4 is {values['k4']} with a perspective camera_model; expected 0: four "
                       f"radial coefficients are {_FISHEYE}'s")
    return tuple(float(values.get(key, 0.0)) for key in _COEFFICIENTS[model])
