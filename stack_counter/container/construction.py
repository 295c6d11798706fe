# SPDX-License-Identifier: Apache-2.0
"""Makes a `Container` of a wall: fitted, taught, or configured with size and pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.types import Container, WallShape


@dataclass(frozen=True)
class ConstructionSettings:
    """How finely a wall is drawn, and when it has the size that was given.

    Attributes:
        levels: number of outlines of a wall, from the support plane to the rim; chosen.
        larger_floor: by how much a configured size at the floor may exceed that at a rim that was
            measured, m; chosen.
        size_tolerance_m, size_tolerance: by how much a measured size may differ from the
            configured one, m, and as a share of it; chosen: `evaluate volume` finds 0.2% off.
        thick_floor_m: by how much a floor may be thicker than the wall where the depth is
            configured and the floor's thickness is not, m; chosen.
        worn_voxels: voxels by which a fused rim of no thickness would lie too low; measured on 28
            boxes and cups of train-deep and train-shallow and on boxes in closed form.
        worn_decay: how fast that falls with the wall's thickness in voxels; measured with it.
    """

    levels: int = 17
    larger_floor: float = 0.002
    size_tolerance_m: float = 0.005
    size_tolerance: float = 0.03
    thick_floor_m: float = 0.008
    worn_voxels: float = 1.8
    worn_decay: float = 1.1


SETTINGS = ConstructionSettings()


def worn_rim_height(thickness: float, voxel_size: float) -> float:
    """By how much the fused surface shows a rim too low, metres: thin edges are worn.

    Args:
        thickness: of the wall, metres.
        voxel_size: metres.
    """
    s = SETTINGS
    return s.worn_voxels * voxel_size * float(np.exp(-s.worn_decay * thickness / voxel_size))


def make_container(shape: WallShape, thickness: float, height: float, floor: float,
                   plane_z: float) -> Container:
    """Makes the container of a wall.

    Args:
        shape: outer face of the wall, world frame.
        thickness: of the wall, metres, measured horizontally.
        height: of the rim above the support plane, metres.
        floor: thickness of the floor, metres.
        plane_z: world height of the support plane, metres.
    """
    # Frame at the wall's middle on the support plane.
    (x, y), yaw = shape.center, shape.yaw
    c, s = np.cos(yaw), np.sin(yaw)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, y, plane_z]))
    # Outlines of the inner wall in that frame, from the support plane to the rim.
    rings = np.stack([
        np.pad((shape.ring(height - z, thickness) - [x, y]) @ T[:2, :2], ((0, 0), (0, 1)),
               constant_values=z)
        for z in np.linspace(0, height, SETTINGS.levels)])
    size_x, size_y = np.ptp(rings[-1, :, :2], axis=0)
    return Container(kind=shape.kind, T_world_container=T,
                     inner_size_m=(float(size_x), float(size_y), height - floor),
                     wall_thickness_m=thickness, floor_thickness_m=floor, rings=rings,
                     wall_shape=shape.in_own_frame())


def no_container(region: Region) -> Container:
    """A heap: the frame stands on the support plane in the middle of the region."""
    center = (region.low + region.high) / 2
    return Container("none", geometry.pose(np.eye(3), np.append(center[:2], region.plane_z)))


def with_floor(container: Container, floor: float) -> Container:
    """The container with another floor thickness, metres, below the same rim."""
    size_x, size_y, depth = container.inner_size_m
    rim = container.floor_thickness_m + depth
    return replace(container, floor_thickness_m=floor, inner_size_m=(size_x, size_y, rim - floor))


def make_configured_container(config: ReconstructorConfig, region: Region) -> Container:
    """Makes the container whose size and pose are both configured.

    Args:
        config: `container_kind`, `container_xyyaw` and `container_*_m`; the walls are vertical
            where no size at the floor is given.
        region: with the height of the support plane.

    Raises:
        ScanError: no kind with sizes, a size is 0, or the floor is larger than the rim.
    """
    size = config.container_inner_size_m
    if not all(size) or config.container_kind == "free":
        raise ScanError(f"container_kind is {config.container_kind} and container_inner_size_m "
                        f"{size}; a container whose pose is given needs three sizes above 0 and "
                        "the kind box or round")
    (x, y, yaw), wall = config.container_xyyaw, config.container_wall_m
    shape: WallShape = BoxWall(np.array([x, y, yaw, size[0] + 2 * wall, size[1] + 2 * wall, 0.0]))
    if config.container_kind == "round":
        shape = RoundWall(np.array([x, y, size[0] / 2 + wall, 0.0, 0.0]))
    shape = _with_floor_size(shape, wall, size[2], config)
    floor = config.container_floor_m or wall
    base = config.container_base_m if np.isfinite(config.container_base_m) else 0.0
    return make_container(shape, wall, floor + size[2], floor, region.plane_z + base)


def make_fitted_container(shape: WallShape, thickness: float, height: float, base: float,
                          region: Region, config: ReconstructorConfig, worn: float = 0.0
                          ) -> Container:
    """Makes the container of a fitted wall; configured sizes replace the fitted ones.

    Args:
        shape: fitted outer face, world frame.
        thickness: of the wall, metres, measured horizontally.
        height: of the rim above the support plane, metres.
        base: height of the underside above the support plane, metres.
        region: with the height of the support plane.
        config: `container_inner_size_m`, `container_floor_size_m` and `container_floor_m`; zeros
            are measured.
        worn: by how much the rim was measured too low, metres; a given depth begins so much
            higher.

    Raises:
        ScanError: the size at the floor is larger than that at the rim, or given for a free form.
    """
    size = config.container_inner_size_m
    # Horizontal size at the rim.
    if size[0] and isinstance(shape, BoxWall):
        shape = _with_outer_size(shape, np.array(size[:2]) + 2 * thickness)
    if size[0] and isinstance(shape, RoundWall):
        shape = RoundWall(np.array([*shape.params[:2], size[0] / 2 + thickness,
                                    *shape.params[3:]]))
    # Floor, as thick as the wall where it is not configured, and depth.
    height -= base
    floor = config.container_floor_m or thickness
    if size[2]:
        floor = config.container_floor_m or max(height + worn - size[2], 0.0)
        height = floor + size[2]
    shape = _with_floor_size(shape, thickness, height - floor, config)
    return make_container(shape, thickness, height, floor, region.plane_z + base)


def has_given_size(shape: WallShape, thickness: float, height: float,
                   config: ReconstructorConfig) -> bool:
    """Whether a fitted wall may be that of the container whose inner size is configured.

    Args:
        shape: fitted outer face, world frame.
        thickness: of the wall, metres, measured horizontally.
        height: of the rim above the support plane, metres.
        config: `container_inner_size_m`; zeros are not compared.
    """
    given = np.array(config.container_inner_size_m)
    if given[2] > height + SETTINGS.size_tolerance_m:  # deeper than it stands high
        return False
    if not given[0]:
        return True
    sides = np.sort(np.ptp(shape.in_own_frame().ring(0.0, thickness), axis=0))
    off = np.abs(sides - np.sort(given[:2]))
    return bool(np.all(off <= np.maximum(SETTINGS.size_tolerance_m,
                                         SETTINGS.size_tolerance * sides)))


def has_plausible_floor(container: Container, config: ReconstructorConfig) -> bool:
    """Whether a configured depth leaves a floor about as thick as the wall below it.

    Args:
        container: as made of the fitted wall.
        config: `container_inner_size_m` and `container_floor_m`.
    """
    if not config.container_inner_size_m[2] or config.container_floor_m:
        return True
    return container.floor_thickness_m < container.wall_thickness_m + SETTINGS.thick_floor_m


def _with_outer_size(shape: BoxWall, size: np.ndarray) -> BoxWall:
    """The box with sides of `size` (2,), metres, the longer one where the longer one was found."""
    x, y, yaw, a, b, draft = shape.params
    if (size[0] > size[1]) != (a > b):
        yaw += np.pi / 2
    return BoxWall(np.array([x, y, yaw, *size, draft]))


def _with_floor_size(shape: WallShape, thickness: float, depth: float,
                     config: ReconstructorConfig) -> WallShape:
    """The shape whose draft follows from its size at the rim and the configured one at the floor.

    Args:
        shape: outer face, its rim as it shall be.
        thickness: of the wall, metres, measured horizontally.
        depth: from the rim to the inner floor, metres.
        config: `container_floor_size_m`; zeros leave the shape as it is.

    Raises:
        ScanError: the floor is larger than the rim, has one side only, or the form is free.
    """
    floor = np.array(config.container_floor_size_m)
    if not floor.any():
        return shape
    rim = np.ptp(shape.in_own_frame().ring(0.0, thickness), axis=0)
    if not config.container_inner_size_m[0] and (floor[0] > floor[1]) != (rim[0] > rim[1]):
        floor = floor[::-1]  # which side is x is not said: the longer one is the longer one's
    given = f"container_floor_size_m is {config.container_floor_size_m}"
    if not isinstance(shape, (BoxWall, RoundWall)):
        raise ScanError(f"{given} and the container found is of kind {shape.kind}; expected box "
                        "or round: set container_kind, or teach the container by its CAD file")
    if not floor.all() or (floor > rim + SETTINGS.larger_floor).any():
        raise ScanError(f"{given} at a rim of {rim[0]:.3f} x {rim[1]:.3f} m; expected two sides "
                        "above 0 and no larger than at the rim")
    drafts = np.maximum(rim - floor, 0.0) / 2 / depth
    if isinstance(shape, RoundWall):
        return RoundWall(np.array([*shape.params[:3], drafts[0], -drafts[0]**2]))
    return BoxWall(np.append(shape.params[:5], drafts[0]), float(drafts[1] - drafts[0]))
