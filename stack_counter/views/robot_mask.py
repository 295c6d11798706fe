# SPDX-License-Identifier: Apache-2.0
"""Which pixels of a depth image show the robot: its URDF, rendered at its joints' positions."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ConfigError, ViewError
from stack_counter.types import View

_DRIVEN = ("revolute", "continuous", "prismatic", "fixed")


@dataclass(frozen=True)
class RobotMaskSettings:
    """What counts as robot around its model; chosen.

    Attributes:
        margin_m: by so much the robot is taken to be larger than its model, metres: a hand-eye
            calibration's error at arm's length, the noise of the depth, and cables.
        band: ratio of the distances of what is grown together: the margin is wider in pixels the
            nearer it is.
        nearest_m: nearest distance along z at which the robot is looked for, metres: what is
            nearer is the camera's own housing.
        measured_from_m: from this distance on a depth camera measures whatever is there, metres.
        misplaced_m: what is measured so far behind the robot is not the robot, metres.
        misplaced_share: share of the robot's pixels of which that must not be so.
        least_share: share of the image below which too little of the robot shows to say.
    """

    margin_m: float = 0.02
    band: float = 1.5
    nearest_m: float = 0.05
    measured_from_m: float = 0.3
    misplaced_m: float = 0.04
    misplaced_share: float = 0.5
    least_share: float = 0.002


SETTINGS = RobotMaskSettings()


class RobotMask:
    """The model of a robot.

    Attributes:
        base_link: name of the link that all others hang on.
        joint_names: joints whose positions say where the links are.
    """

    def __init__(self, urdf: Path):
        """Reads the model: of every link both the collision and the visual geometry.

        Collision meshes alone leave a fiftieth of a UR5e in the picture, which they do not cover.

        Args:
            urdf: URDF file; meshes lie relative to it, or in packages that are beside it or that
                AMENT_PREFIX_PATH names.

        Raises:
            ConfigError: no such file, no URDF, or a mesh or joint that cannot be used.
        """
        self._model = _read_urdf(urdf)
        self.base_link = str(self._model.base_link)
        self.joint_names = tuple(self._model.actuated_joint_names)
        graph = self._model.scene.graph
        self._solids = [(node, self._model.scene.geometry[graph[node][1]])
                        for node in graph.nodes_geometry]
        triangles = [len(getattr(solid, "faces", ())) for _, solid in self._solids]
        if not triangles or not min(triangles):
            raise ConfigError(f"{urdf}: no triangles in {'a mesh' if triangles else 'any link'}; "
                              "expected boxes, cylinders, spheres or meshes")

    def has_link(self, name: str) -> bool:
        """Whether the robot has a link of this name."""
        return name in self._model.link_map

    def link_pose(self, name: str, positions: Mapping[str, float]) -> np.ndarray:
        """(4, 4) T_base_link of a link at these joint positions, rad or m."""
        self._model.update_cfg(dict(positions))
        return self._model.get_transform(name)

    def depth_without_robot(self, view: View, T_world_base: np.ndarray,
                            positions: Mapping[str, float]) -> np.ndarray:
        """The depth of a view where it shows something else than the robot.

        Args:
            view: pinhole view with depth.
            T_world_base: (4, 4) pose of `base_link`.
            positions: of all joints, rad or m.

        Returns:
            (h, w) float32 metres, 0 where the robot is, or where it hides what was measured.

        Raises:
            ViewError: reason `robot_misplaced`: what is measured lies behind most of the robot.
        """
        depth = np.asarray(view.depth)
        robot = self._render(view, T_world_base, positions)
        _check_place(robot, depth)
        robot = _grown(robot, view.intrinsics.fx)
        return np.where(depth > robot - SETTINGS.margin_m, np.float32(0), depth)

    def _render(self, view: View, T_world_base: np.ndarray, positions: Mapping[str, float]
                ) -> np.ndarray:
        """(h, w) float32 depth of the robot alone, metres, infinite where it is not."""
        from stack_counter.lean_open3d import o3c, o3d  # slow to load, and only needed here

        self._model.update_cfg(dict(positions))
        T_camera_base = geometry.inverse(view.T_world_camera) @ T_world_base
        scene = o3d.t.geometry.RaycastingScene()
        for node, solid in self._solids:
            T = T_camera_base @ self._model.scene.graph[node][0]
            scene.add_triangles(
                o3c.Tensor(geometry.apply(T, solid.vertices).astype(np.float32)),
                o3c.Tensor(solid.faces.astype(np.uint32)))
        rays = geometry.pixel_rays(view.intrinsics)
        hits = scene.cast_rays(o3c.Tensor(
            np.concatenate([rays * np.float32(SETTINGS.nearest_m), rays], -1)))
        return hits["t_hit"].numpy() + np.float32(SETTINGS.nearest_m)


def _check_place(robot: np.ndarray, depth: np.ndarray) -> None:
    """Refuses a view that shows something else where the robot should be.

    Args:
        robot: (h, w) rendered depth, metres, infinite where it is not.
        depth: (h, w) measured depth, metres, 0 where invalid.

    Raises:
        ViewError: reason `robot_misplaced`.
    """
    both = np.isfinite(robot) & (robot > SETTINGS.measured_from_m) & (depth > 0)
    behind = depth[both] - robot[both]
    share = np.mean(behind > SETTINGS.misplaced_m) if behind.size else 0.0
    if behind.size > SETTINGS.least_share * depth.size and share > SETTINGS.misplaced_share:
        raise ViewError("robot_misplaced", f"{share:.0%} of the pixels where the robot should be "
                                           f"show what is {np.median(behind):.2f} m behind it; "
                                           "expected the robot: check its joint states, its "
                                           "stamps, the URDF and the transform to its base")


def _grown(robot: np.ndarray, focal_px: float) -> np.ndarray:
    """A rendered depth image, (h, w) float32 metres, with everything larger by the margin."""
    grown = robot.copy()
    seen = robot[np.isfinite(robot)]
    low = seen.min(initial=np.inf)
    while low <= seen.max(initial=0):
        high = low * SETTINGS.band
        band = np.where((robot >= low) & (robot < high), robot, np.float32(np.inf))
        reach = int(np.ceil(SETTINGS.margin_m * focal_px / low))
        window = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        grown = np.minimum(grown, cv2.erode(band, window))
        low = high
    return grown


def _read_urdf(path: Path) -> Any:
    """The model of a URDF file with the meshes of its links.

    Raises:
        ConfigError: see `RobotMask`.
    """
    try:
        import yourdfpy
    except ImportError as error:
        raise ConfigError("robot_description_file needs yourdfpy: pip install "
                          "'stack_counter[robot]'") from error
    if not path.is_file():
        raise ConfigError(f"no URDF {path}; expected the file that robot_description_file names")
    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)  # what matters is raised
    try:
        parsed = yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False)
        odd = [f"{j.name} ({j.type})" for j in parsed.robot.joints if j.type not in _DRIVEN]
        if odd:
            raise ConfigError(f"{path}: joint {odd[0]}; expected one of {_DRIVEN}")
        for link in parsed.robot.links:
            link.visuals = [*link.collisions, *link.visuals]
        return yourdfpy.URDF(parsed.robot, filename_handler=partial(_find_mesh, path))
    except ConfigError:
        raise
    except Exception as error:  # of XML, of meshes: many classes
        line = (str(error).splitlines() or [""])[0]
        raise ConfigError(f"{path}, or a mesh of it, cannot be read ({type(error).__name__}: "
                          f"{line}); expected URDF") from error


def _find_mesh(urdf: Path, fname: str) -> str:
    """Path of a mesh that a URDF names, by file, package or relative to it.

    Raises:
        ConfigError: there is none.
    """
    scheme, _, rest = fname.rpartition("://")
    if scheme == "package":
        package, _, inside = rest.partition("/")
        shares = [Path(prefix) / "share" for prefix in
                  os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
        folders = [*urdf.resolve().parents, *shares]
        found = [folder / package / inside for folder in folders] + [
            folder / inside for folder in urdf.resolve().parents if folder.name == package]
    else:
        found = [urdf.parent / rest]
    for path in found:
        if path.is_file():
            return str(path)
    raise ConfigError(f"{urdf}: no mesh {fname}; expected it beside the URDF, or in a package "
                      "that AMENT_PREFIX_PATH names")
