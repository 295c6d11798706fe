"""The cameras that a collector listens to: one, or those of a rig file.

A rig file (YAML) names the cameras of a fixed station; `config/rig_example.yaml` documents it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stack_counter import geometry
from stack_counter.config import CollectorConfig, build
from stack_counter.errors import ConfigError, ViewError
from stack_counter.types import View, ViewTally
from stack_counter.views.assembler import ViewAssembler

_TOPICS = ("color_topic", "color_transport", "camera_info_topic", "depth_topic", "labels_topic")
_OWN = (*_TOPICS, "pose", "frame")
_TRIGGER = {"tolerance_s": 0.05, "timeout_s": 1.0}


@dataclass(frozen=True)
class RigCamera:
    """One camera: its name and settings, its pose in the world where the file gives it (4, 4),
    else TF does, and there its frame, if that is another than its images name."""

    name: str
    config: CollectorConfig
    T_world_camera: np.ndarray | None = None
    frame: str = ""


@dataclass(frozen=True)
class Rig:
    """Cameras and what makes a cycle of their images.

    Attributes:
        cameras: at least one.
        tolerance_s: images whose stamps differ by no more are of one cycle, s.
        timeout_s: a camera that gave nothing so long after the first of a cycle is missing, s.
    """

    cameras: tuple[RigCamera, ...]
    tolerance_s: float = _TRIGGER["tolerance_s"]
    timeout_s: float = _TRIGGER["timeout_s"]


def load_rig(config: CollectorConfig) -> Rig:
    """The rig that the settings name, or the one camera that they describe.

    Raises:
        ConfigError: no such file, not YAML, unknown keys or values out of range.
    """
    if config.mode == "cycle":  # each image was asked for, whether anything has changed or not
        config = replace(config, min_change=0.0, min_motion_m=0.0, min_motion_rad=0.0)
    if not config.rig:
        return Rig((RigCamera("", config),))
    path = Path(config.rig)
    try:
        document = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ConfigError(f"no rig file {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(document, dict) or not isinstance(document.get("cameras"), dict) \
            or not document["cameras"]:
        raise ConfigError(f"{path} lacks cameras; expected 'cameras: NAME: ...'")
    unknown = set(document) - {"cameras", "trigger"}
    if unknown:
        raise ConfigError(f"{path}: unknown {sorted(unknown)}; expected cameras and trigger")
    cameras = tuple(_camera(path, str(name), body or {}, config)
                    for name, body in document["cameras"].items())
    colors = [c.config.color_topic for c in cameras]
    if len(set(colors)) < len(colors):
        raise ConfigError(f"{path}: two cameras on one color_topic of {sorted(colors)}; expected "
                          "one each")
    return Rig(cameras, **_trigger(path, document.get("trigger") or {}))


def _camera(path: Path, name: str, body: Any, base: CollectorConfig) -> RigCamera:
    where = f"{path}: camera '{name}'"
    if not isinstance(body, dict) or set(body) - set(_OWN):
        raise ConfigError(f"{where} is {body!r}; expected some of {list(_OWN)}")
    if "color_topic" not in body or "camera_info_topic" not in body:
        raise ConfigError(f"{where} has {sorted(body)}; expected color_topic and "
                          "camera_info_topic")
    values = {f.name: getattr(base, f.name) for f in fields(base)} | {"depth_topic": ""}
    try:
        config = build(CollectorConfig, values | {k: body[k] for k in _TOPICS if k in body})
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    return RigCamera(name, config, _pose(where, body.get("pose")), str(body.get("frame", "")))


def _pose(where: str, body: Any) -> np.ndarray | None:
    if body is None:
        return None
    try:
        return geometry.pose_from_quaternion(np.array(body["quaternion_xyzw"], float),
                                             np.array(body["xyz_m"], float))
    except (KeyError, TypeError, ValueError, ViewError) as error:
        raise ConfigError(f"{where}: pose {body}; expected xyz_m of three numbers and "
                          "quaternion_xyzw of length 1") from error


def _trigger(path: Path, body: Any) -> dict[str, float]:
    if not isinstance(body, dict) or set(body) - set(_TRIGGER):
        raise ConfigError(f"{path}: trigger is {body!r}; expected some of {sorted(_TRIGGER)}")
    values = {**_TRIGGER, **body}
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 3600:
            raise ConfigError(f"{path}: {key} is {value!r}; expected seconds above 0")
    return values


class RigAssembler:
    """The assemblers of all cameras as one."""

    def __init__(self, rig: Rig, live: bool = True):
        """`live`: as for `ViewAssembler`."""
        self.rig = rig
        self.of = {c.name: ViewAssembler(c.config, live, c.T_world_camera, c.frame)
                   for c in rig.cameras}

    def start(self) -> None:
        """A new scan: see `ViewAssembler.start`."""
        for assembler in self.of.values():
            assembler.start()

    @property
    def tally(self) -> ViewTally:
        """Images received, views accepted, skipped by reason; of all cameras."""
        tallies = [a.tally for a in self.of.values()]
        skipped: Counter[str] = sum((Counter(t.skipped) for t in tallies), Counter())
        return ViewTally(sum(t.received for t in tallies), sum(t.used for t in tallies),
                         dict(skipped))

    @property
    def waiting(self) -> int:
        """Images that wait for something."""
        return sum(a.waiting for a in self.of.values())

    @property
    def last_errors(self) -> list[str]:
        """The last line for each reason of each camera."""
        return [f"{name}: {line}" if name else line for name, a in self.of.items()
                for line in a.last_error.values()]

    def add_transform(self, message: Any, static: bool) -> None:
        """A `TransformStamped` of /tf or /tf_static."""
        for assembler in self.of.values():
            assembler.add_transform(message, static)

    def takers(self) -> dict[str, list[tuple[str, Callable[[Any], None]]]]:
        """What to do with a message of a topic: for each camera that listens to it, the kind of
        the topic (`color`, `info`, `depth`, `labels`, `pose`) and the method that takes it."""
        out: dict[str, list[tuple[str, Callable[[Any], None]]]] = {}
        for camera in self.rig.cameras:
            c, a = camera.config, self.of[camera.name]
            suffix = "/compressed" if c.color_transport == "compressed" else ""
            wanted = [(c.color_topic + suffix, "color", a.add_color),
                      (c.camera_info_topic, "info", a.add_camera_info),
                      (c.depth_topic, "depth", a.add_depth),
                      (c.labels_topic, "labels", a.add_labels)]
            if c.pose_source == "topic" and camera.T_world_camera is None:
                wanted.append((c.pose_topic, "pose", a.add_pose))
            for topic, kind, take in wanted:
                if topic:
                    out.setdefault(topic, []).append((kind, take))
        return out

    def color_topics(self) -> list[str]:
        """Of all cameras."""
        return [topic for topic, takers in self.takers().items() if takers[0][0] == "color"]

    @property
    def needs_tf(self) -> bool:
        """Whether some camera's pose comes from TF."""
        return any(c.T_world_camera is None and c.config.pose_source == "tf"
                   for c in self.rig.cameras)

    def poll(self) -> list[tuple[str, View]]:
        """The views that are complete now, with their cameras' names."""
        return [(name, view) for name, a in self.of.items() for view in a.poll()]

    def flush(self) -> list[tuple[str, View]]:
        """The end of a scan or bag: decides all that wait."""
        return [(name, view) for name, a in self.of.items() for view in a.flush()]

