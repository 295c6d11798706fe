# SPDX-License-Identifier: Apache-2.0
"""A taught bin is found where it stands: a box of walls in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from kits.analytic import Scene

from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.placement import (
    SETTINGS,
    PlacedWall,
    _sunk_depth,
    place_container,
)
from stack_counter.container.wall_shapes import BoxWall, FreeWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import HeightMap, InnerMap, Mesh

INNER, WALL, FLOOR, FILL = (0.24, 0.16, 0.1), 0.008, 0.005, 0.03
RIM = FLOOR + INNER[2]
TAUGHT = TaughtContainer(BoxWall(np.array([0, 0, 0, 0.256, 0.176, 0.0])), WALL, FLOOR, RIM)
REGION = Region(np.array([-0.25, -0.25, -0.03]), np.array([0.25, 0.25, 0.15]), 0.0, 0.0003)


def bin_surface(x, y, yaw):
    """The bin as a mesh: four walls and a flat filling, on a plane."""
    a, b, _ = INNER
    boxes = [((a + 2 * WALL, WALL, RIM), (0, side * (b + WALL) / 2, RIM / 2)) for side in (-1, 1)]
    boxes += [((WALL, b, RIM), (side * (a + WALL) / 2, 0, RIM / 2)) for side in (-1, 1)]
    boxes.append(((a, b, FLOOR + FILL), (0, 0, (FLOOR + FILL) / 2)))
    mesh = trimesh.util.concatenate([
        trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle))
        for size, middle in boxes])
    mesh.apply_transform(trimesh.transformations.rotation_matrix(yaw, [0, 0, 1]))
    mesh.apply_translation([x, y, 0])
    return FusedSurface(Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32)))


def place(taught, pose, region=REGION, **settings):
    x, y, yaw = pose
    views = Scene().bin(INNER, WALL, FLOOR, FILL, x, y, yaw).views(6, noise=0.0003)
    return place_container(taught, bin_surface(x, y, yaw), views, region, 0.002,
                           ReconstructorConfig(container="mine", **settings))


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.7), (-0.04, 0.01, 2.6)])
def test_it_is_found_at_any_yaw(pose):
    T = place(TAUGHT, pose).T_world_container
    np.testing.assert_allclose(T[:3, 3], [*pose[:2], 0.0], atol=5e-4)
    # Half a turn brings a box onto itself.
    turned = np.arctan2(T[1, 0], T[0, 0]) - pose[2]
    assert np.sin(turned) == pytest.approx(0, abs=3e-3)


def test_another_outline_is_refused():
    """An oval is not the outline of a box."""
    radii = np.zeros(17)
    radii[[0, 2]] = 0.11, 0.02
    taught = TaughtContainer(FreeWall.from_outline(np.zeros(2), radii), WALL, FLOOR, RIM)
    with pytest.raises(ScanError, match="container 'mine' not found: a rim 0.105 m high on"):
        place(taught, (0.0, 0.0, 0.4))


def test_another_size_or_height_is_not_found():
    larger = TaughtContainer(BoxWall(np.array([0, 0, 0, 0.3, 0.176, 0.0])), WALL, FLOOR, RIM)
    lower = TaughtContainer(TAUGHT.wall_shape, WALL, FLOOR, RIM - 0.03)
    for other in (larger, lower):
        with pytest.raises(ScanError, match="expected 75%|walls below"):
            place(other, (0.0, 0.0, 0.3))


def test_half_a_turn_sinks_the_surface_into_a_ledge():
    """The ledge is 0.05 m high and takes a sixth of the container, at its end of +x."""
    heights = np.full((80, 120), FLOOR, np.float32)
    heights[:, 100:] = 0.05
    taught = replace(TAUGHT, inner_map=InnerMap(0.002, heights))
    corner = np.eye(4)
    corner[:2, 3] = -0.12, -0.08
    seen = HeightMap(corner, 0.002, heights)
    right, turned = (_sunk_depth(PlacedWall(np.array([0, 0, yaw]), TAUGHT.wall_shape), taught,
                                 seen, 0.0) for yaw in (0.0, np.pi))
    assert right == 0
    # All but the margin beside the ledge is sunk by its height less the margin.
    margin = SETTINGS.sunk_margin
    depth = 0.05 - FLOOR - margin
    assert (20 - margin / 0.002 - 2) / 120 * depth < turned < 20 / 120 * depth
    assert _sunk_depth(PlacedWall(np.zeros(3), TAUGHT.wall_shape), TAUGHT, seen, 0.0) == 0


def test_a_given_pose_is_used_and_the_plane_follows_the_rim():
    low = Region(REGION.low, REGION.high, -0.002, REGION.noise)  # the plane is measured too low
    pose = (0.03, -0.02, 0.7)
    box = place(TAUGHT, pose, low, container_pose="given", container_xyyaw=pose)
    np.testing.assert_allclose(box.T_world_container[:3, 3], [*pose[:2], 0.0], atol=1e-4)
    assert box.inner_size_m == pytest.approx((0.24, 0.16, 0.1))
    assert box.wall_shape is TAUGHT.wall_shape
