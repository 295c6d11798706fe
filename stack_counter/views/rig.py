# SPDX-License-Identifier: Apache-2.0
"""The cameras that a collector subscribes to: one, or those of a rig file.

A rig file (YAML) names the cameras of a fixed station; `config/rig_example.yaml` documents it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stack_counter import geometry
from stack_counter.config import CollectorConfig, build_section
from stack_counter.errors import ConfigError, ViewError

_TOPICS = ("color_topic", "color_transport", "camera_info_topic", "depth_topic",
           "depth_camera_info_topic", "depth_scale", "labels_topic")
_CAMERA_KEYS = (*_TOPICS, "pose", "frame")
_TRIGGER = {"tolerance_s": 0.05, "timeout_s": 1.0}


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera.

    Attributes:
        name: its name in the rig; empty for a single camera.
        config: its settings.
        T_world_camera: (4, 4) pose that the rig file gives; None: it comes from TF or a topic.
        frame: name of its frame in TF; empty: the one that its images name.
    """

    name: str
    config: CollectorConfig
    T_world_camera: np.ndarray | None = None
    frame: str = ""


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras, and which of their images are one cycle.

    Attributes:
        cameras: one camera or more.
        tolerance_s: largest difference of stamps within one cycle, seconds.
        timeout_s: a camera that gave nothing for this time after the first image of a cycle is
            missing, seconds.
    """

    cameras: tuple[RigCamera, ...]
    tolerance_s: float = _TRIGGER["tolerance_s"]
    timeout_s: float = _TRIGGER["timeout_s"]


def load_rig(config: CollectorConfig) -> Rig:
    """Reads the rig file that the settings name, or makes a rig of the one camera they describe.

    Raises:
        ConfigError: no such file, not YAML, unknown keys or values out of range.
    """
    if config.mode == "cycle":  # each image was triggered, whether anything has changed or not
        config = replace(config, min_change=0.0, min_motion_m=0.0, min_motion_rad=0.0)
    if not config.rig:
        return Rig((RigCamera("", config),))
    path = Path(config.rig)
    try:
        document = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ConfigError(f"no rig file {path}: {error.strerror}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(document, dict) or not isinstance(document.get("cameras"), dict) \
            or not document["cameras"]:
        raise ConfigError(f"{path} lacks cameras; expected 'cameras: NAME: ...'")
    unknown = set(document) - {"cameras", "trigger"}
    if unknown:
        raise ConfigError(f"{path}: unknown {sorted(unknown)}; expected cameras and trigger")
    cameras = tuple(_read_camera(path, str(name), body or {}, config)
                    for name, body in document["cameras"].items())
    colors = [c.config.color_topic for c in cameras]
    if len(set(colors)) < len(colors):
        raise ConfigError(f"{path}: two cameras on one color_topic of {sorted(colors)}; expected "
                          "one each")
    return Rig(cameras, **_read_trigger(path, document.get("trigger") or {}))


def _read_camera(path: Path, name: str, body: Any, base: CollectorConfig) -> RigCamera:
    where = f"{path}: camera '{name}'"
    if not isinstance(body, dict) or set(body) - set(_CAMERA_KEYS):
        raise ConfigError(f"{where} is {body!r}; expected some of {list(_CAMERA_KEYS)}")
    if "color_topic" not in body or "camera_info_topic" not in body:
        raise ConfigError(f"{where} has {sorted(body)}; expected color_topic and "
                          "camera_info_topic")
    values = {f.name: getattr(base, f.name) for f in fields(base)}
    values |= {"depth_topic": "", "depth_camera_info_topic": ""}
    try:
        config = build_section(
            CollectorConfig, values | {k: body[k] for k in _TOPICS if k in body}
        )
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    return RigCamera(name, config, _read_pose(where, body.get("pose")), str(body.get("frame", "")))


def _read_pose(where: str, body: Any) -> np.ndarray | None:
    if body is None:
        return None
    try:
        return geometry.pose_from_quaternion(
            np.array(body["quaternion_xyzw"], float).reshape(4),
            np.array(body["xyz_m"], float).reshape(3))
    except (KeyError, TypeError, ValueError, OverflowError, ViewError) as error:
        raise ConfigError(f"{where}: pose {body}; expected xyz_m of three numbers and "
                          "quaternion_xyzw of length 1") from error


def _read_trigger(path: Path, body: Any) -> dict[str, float]:
    if not isinstance(body, dict) or set(body) - set(_TRIGGER):
        raise ConfigError(f"{path}: trigger is {body!r}; expected some of {sorted(_TRIGGER)}")
    values = {**_TRIGGER, **body}
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 3600:
            raise ConfigError(f"{path}: {key} is {value!r}; expected seconds above 0")
    return values
