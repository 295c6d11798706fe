# SPDX-License-Identifier: Apache-2.0
"""Finds the container of a scan in the fused surface and the views, if there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.base import find_base
from stack_counter.container.construction import (
    has_given_size,
    has_plausible_floor,
    make_configured_container,
    make_fitted_container,
    no_container,
    worn_rim_height,
)
from stack_counter.container.openings import (
    find_openings,
    isolate_opening,
    several_containers,
)
from stack_counter.container.rim import Rim, find_rim
from stack_counter.container.silhouettes import WallOutlines
from stack_counter.container.wall_fit import (
    FacePoints,
    FittedWall,
    find_face_points,
    fit_wall,
)
from stack_counter.container.wall_foot import reaches_base
from stack_counter.container.wall_thickness import expected_thickness
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region, seen_from_one_side
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import CONTAINER, Container, HeightMap, View


@dataclass(frozen=True)
class DetectionSettings:
    """When a rim and a wall below it are a container; all values are chosen.

    "Share" means the share of the sectors around the container in which a rim, or one face of the
    wall (the one that more of them show), was seen.

    Attributes:
        map_pitch: least side of a cell of the map in which the rim is looked for, m.
        map_cells: largest number of cells along a side of that map.
        min_rim_height: least height of a rim above the support plane, m.
        min_rim: least share of the rim.
        min_face: least share of the wall's face.
        min_drop: least share of the rim in which the surface falls on its inner side: at least
            0.09 in 110 containers of the training sets, 60 of them full to the rim, and 0.05
            around a full rack, 0.01 around a ball, whose far side looks like an inner face.
        weak_rim: least share of a rectangular or round rim whose wall makes up for the rest.
        weak_sum: least sum of its share and its wall's.
        one_side_rim: least share of the rim where all views come from one side.
        one_side_face: least share of the inner face there; no outer face shows.
        unsure_share: least share of rim and face of what may be a container that was not found.
        unsure_sum: least sum of both of a rectangular or round one.
        unsure_sum_free: least sum of both of a free-form one.
        max_spread: largest standard deviation of the faces around their fit, m, for depth without
            noise.
        noise_spread: what each metre of the depth's noise adds to that, m.
        max_beyond_region: distance beyond a configured region up to which a rim may reach, m.
    """

    map_pitch: float = 0.001
    map_cells: int = 400
    min_rim_height: float = 0.006
    min_rim: float = 0.75
    min_face: float = 0.8
    min_drop: float = 0.08
    weak_rim: float = 0.6
    weak_sum: float = 1.6
    one_side_rim: float = 0.45
    one_side_face: float = 0.4
    unsure_share: float = 0.5
    unsure_sum: float = 1.45
    unsure_sum_free: float = 1.7
    max_spread: float = 0.00045
    noise_spread: float = 0.3
    max_beyond_region: float = 0.004


SETTINGS = DetectionSettings()


@dataclass(frozen=True, eq=False)
class FoundContainer:
    """What a search for a container found.

    Attributes:
        container: of kind `none` where it found none.
        sure: False if it is `none` though something rim-like stands around the stack.
        as_given: False if its size, as found, is not the configured one.
        reaches_base: False if its wall is not seen down to its underside, though it should be.
    """

    container: Container
    sure: bool
    as_given: bool = True
    reaches_base: bool = True


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A rim and the wall fitted below it, which may be a container's.

    Attributes:
        rim: as found in the map.
        wall: below it.
        points: that the wall was fitted to, with others among them.
    """

    rim: Rim
    wall: FittedWall
    points: FacePoints


def find_container(surface: FusedSurface, views: list[View], region: Region, voxel_size: float,
                   config: ReconstructorConfig, unit_volume: float = 0.0) -> FoundContainer:
    """Makes the container as configured, or finds it.

    Args:
        surface: fused from the views.
        views: with depth.
        region: where to look; its `plane_z` is the support plane.
        voxel_size: metres.
        config: `container_*` settings; zeros are measured.
        unit_volume: volume of one part, m3; 0: not known.

    Returns:
        A container of kind `box`, `round`, `free` or `none`, the floor's thickness being the
        configured one, else the wall's.

    Raises:
        ScanError: a kind is configured and no such rim is found, several containers are, or the
            one that is reaches beyond a configured region.
    """
    if config.container_kind == "none":
        return FoundContainer(no_container(region), True)
    if config.container_pose == "given":
        return FoundContainer(make_configured_container(config, region), True)
    # Find a rim, and fit the wall below it.
    everything = rim_map(surface, region, voxel_size)
    top = choose_opening(everything, region, unit_volume)
    rim = find_rim(top, region.noise_height, config.container_kind)
    candidate = None if rim is None else _fit_wall_below(rim, views, region, config)
    # Decide whether they are a container's.
    if candidate is not None and _is_accepted(candidate, views, region):
        shape, thickness = candidate.wall.shape, candidate.wall.thickness
        rim_height, worn = candidate.rim.height, worn_rim_height(thickness, voxel_size)
        base = find_base(everything, views, candidate.wall, candidate.points, rim_height, worn,
                         region, config)
        container = make_fitted_container(shape, thickness, rim_height, base, region, config, worn)
        check_reach(container, region)
        as_given = has_given_size(shape, thickness, rim_height if region.support_certain
                                  else np.inf, config) \
            and has_plausible_floor(container, config)
        return FoundContainer(container, True, as_given, reaches_base(
            everything, views, candidate.wall, candidate.points, rim_height, base, region))
    if config.container_kind != "auto":
        raise ScanError(f"no {config.container_kind} container found: a level rim on "
                        f"{rim.outline_share if rim else 0.0:.0%} of its outline, a wall below it "
                        f"on {candidate.wall.best_face_share if candidate else 0.0:.0%}; expected "
                        f"{SETTINGS.min_rim:.0%} and {SETTINGS.min_face:.0%}")
    return FoundContainer(no_container(region), candidate is None or not _is_rim_like(candidate))


def rim_map(surface: FusedSurface, region: Region, voxel_size: float) -> HeightMap:
    """Map of the region in which a rim is looked for.

    Args:
        surface: whose heights are read.
        region: that the map covers.
        voxel_size: metres; a cell is at least half as large.
    """
    size = (region.high - region.low)[:2]
    pitch = max(SETTINGS.map_pitch, float(size.max()) / SETTINGS.map_cells, voxel_size / 2)
    rows, cols = (int(n) for n in np.ceil(size[::-1] / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    return surface.heights(T_world_map, pitch, (rows, cols))


def choose_opening(top: HeightMap, region: Region, unit_volume: float) -> HeightMap:
    """The map without what stands beside the one container in it.

    Args:
        top: map of the region.
        region: with the height of the support plane.
        unit_volume: volume of one part, m3; 0: not known.

    Raises:
        ScanError: several containers, e.g. bins side by side.
    """
    openings = find_openings(top, unit_volume)
    if len(openings) > 1:
        raise several_containers(openings, region)
    return isolate_opening(top, openings[0]) if openings else top


def check_reach(container: Container, region: Region) -> None:
    """Refuses a container that reaches beyond a configured region.

    Raises:
        ScanError: it does; the region cuts through something.
    """
    if not region.configured or container.rings is None:
        return
    rim = geometry.apply(container.T_world_container, container.rings[-1])[:, :2]
    beyond = max(float((region.low[:2] - rim).max()), float((rim - region.high[:2]).max()))
    if beyond > SETTINGS.max_beyond_region:
        raise ScanError(f"the container reaches {1000 * beyond:.0f} mm beyond the region of "
                        "interest; expected all of it inside: enlarge roi_size_m or move "
                        "roi_center_m")


def _fit_wall_below(rim: Rim, views: list[View], region: Region, config: ReconstructorConfig
                    ) -> _Candidate | None:
    """The rim with the wall fitted below it; None if the rim is too low."""
    if rim.height < SETTINGS.min_rim_height:
        return None
    thickness = expected_thickness(rim, views, region, config)
    points = find_face_points(views, region, rim.outline, rim.height)
    outlines = WallOutlines.of_views(views, rim.outline, rim.height, region.plane_z) \
        if region.stereo_window_m else None
    wall = fit_wall(rim.outline, points, rim.height, thickness, region.noise, outlines)
    return _Candidate(rim, wall, points)


def _is_accepted(found: _Candidate, views: list[View], region: Region) -> bool:
    """Whether rim and wall are a container's, as seen from all around or from one side."""
    labelled = any(np.any(v.labels == CONTAINER) for v in views if v.labels is not None)
    return _is_container(found, region, labelled) \
        or seen_from_one_side(views, region) and _is_container_from_one_side(found)


def _is_container(found: _Candidate, region: Region, labelled: bool) -> bool:
    """Whether rim and wall are a container's.

    A heap has no level rim, and nothing smooth and steep all around below it, unless label images
    show a container (`labelled`); a block has nothing inside.
    """
    s, rim, wall = SETTINGS, found.rim, found.wall
    smooth = wall.spread < s.max_spread + s.noise_spread * region.noise
    steep = wall.best_face_share >= s.min_face
    hollow = rim.inner_drop_share >= s.min_drop
    if rim.outline.kind == "free":  # such an outline bends to many a heap
        return rim.outline_share >= s.min_rim and (labelled or steep and smooth) and hollow
    # A rectangle or a circle fits to no heap: much of a rim makes up for little of a wall.
    if rim.outline_share >= s.min_rim and (labelled or steep) and hollow:
        return True
    return rim.outline_share >= s.weak_rim \
        and rim.outline_share + wall.best_face_share >= s.weak_sum and hollow


def _is_container_from_one_side(found: _Candidate) -> bool:
    """Whether rim and wall are a container's.

    One camera above sees of it the rim and some of the wall's inner face.
    """
    return found.rim.outline.kind != "free" \
        and found.rim.outline_share >= SETTINGS.one_side_rim \
        and found.wall.inner_share >= SETTINGS.one_side_face


def _is_rim_like(found: _Candidate) -> bool:
    """Whether rim and wall are not enough for a container, and too much for none."""
    rim, face = found.rim.outline_share, found.wall.best_face_share
    min_sum = SETTINGS.unsure_sum_free if found.rim.outline.kind == "free" \
        else SETTINGS.unsure_sum
    return min(rim, face) >= SETTINGS.unsure_share and rim + face >= min_sum
