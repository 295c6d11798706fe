# SPDX-License-Identifier: Apache-2.0
"""A container taught by its CAD file: sizes, ledges, V of what lies in it, and what is refused."""

import numpy as np
import pytest
import trimesh
from kits.tubs import FLOOR, WALL, Tub, bucket, circle, drafted_box, stepped_box

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import save_container
from stack_counter.container.inner_map import sample_heights
from stack_counter.container.inner_surface import map_rim_opening
from stack_counter.container.placement import place_container
from stack_counter.errors import MeshError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.pipeline import StackCounter
from stack_counter.teaching.container_mesh import UP_AXES, teach_from_mesh
from stack_counter.types import Mesh


def written(tmp_path, solid, name="tub.stl", scale=1000, turn=None):
    """Path of a solid exported in millimetres, away from the origin; `turn`: its up axis."""
    solid = solid.copy()
    solid.apply_transform(trimesh.transformations.rotation_matrix(0.3, [0, 0, 1]))
    if turn:
        solid.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], UP_AXES[turn]))
    solid.apply_translation([0.5, 0.2, -0.3])
    solid.apply_scale(scale)
    solid.export(tmp_path / name)
    return tmp_path / name


@pytest.mark.parametrize("tub, kind, size", [
    (drafted_box(), "box", (0.3, 0.2)), (drafted_box((0.2, 0.3)), "box", (0.3, 0.2)),
    (drafted_box(corner=0.03), "box", (0.3, 0.2)), (bucket(), "round", (0.28, 0.28))])
def test_walls_floor_and_rim_are_the_files(tmp_path, tub, kind, size):
    taught = teach_from_mesh(written(tmp_path, tub.solid()))
    assert taught.wall_shape.kind == kind
    assert (taught.rim_m, taught.floor_m) == pytest.approx((tub.rim, FLOOR), abs=1e-5)
    assert taught.wall_m == pytest.approx(WALL, abs=3e-4)
    outer = np.ptp(taught.wall_shape.ring(0.0, 0.0), axis=0)
    assert outer == pytest.approx(np.array(size) + 2 * WALL, abs=6e-4)
    foot = np.ptp(taught.wall_shape.ring(tub.rim, 0.0), axis=0)
    assert sorted(foot) == pytest.approx(sorted(np.ptp(tub.outer[0][1], axis=0)), abs=1e-3)


@pytest.mark.parametrize("at_end_only", [False, True])
def test_a_ledge_is_kept_to_a_cell(tmp_path, at_end_only):
    """12 mm wide, 70 mm above the floor: so much lower than the rim is the capacity."""
    tub = stepped_box(at_end_only=at_end_only)
    inner = teach_from_mesh(written(tmp_path, tub.solid())).inner_map
    capacity = float(np.nansum(tub.rim - inner.heights)) * inner.pitch**2
    assert capacity == pytest.approx(tub.volume(tub.rim), rel=2e-3)
    ends = sample_heights(inner, np.array([[-0.142, 0.0], [0.142, 0.0], [0.0, 0.0], [0.16, 0.0]]))
    high = FLOOR + 0.07
    expected = [high, FLOOR] if at_end_only else [high, high]
    assert sorted(ends[:2]) == pytest.approx(sorted(expected), abs=1e-5)
    assert ends[2] == pytest.approx(FLOOR, abs=1e-5) and np.isnan(ends[3])


@pytest.mark.parametrize("tub", [drafted_box(corner=0.03), stepped_box()], ids=["round", "step"])
def test_v_is_that_above_the_inner_surface_of_the_file(tmp_path, tub):
    """Half full, six views; without the file a stepped box gives a quarter too much."""
    save_container("tub", teach_from_mesh(written(tmp_path, tub.solid())), tmp_path / "c.yaml")
    pose = (0.02, -0.01, 0.4)
    scene, truth = tub.scene(0.5, pose)
    stack = StackCounter(ReconstructorConfig(container="tub",
                                             container_catalogue=str(tmp_path / "c.yaml")))
    for view in scene.views(6, radius=0.75, noise=0.0007):
        stack.add_view(view)
    volume = stack.volume()
    assert volume.stack_volume == pytest.approx(truth, rel=0.015)
    np.testing.assert_allclose(volume.container.T_world_container[:3, 3], [*pose[:2], 0.0],
                               atol=5e-4)
    assert volume.container.inner_size_m[2] == pytest.approx(tub.rim - FLOOR, abs=1e-5)


@pytest.mark.parametrize("yaw", [0.4, 0.4 + np.pi])
def test_a_ledge_at_one_end_tells_half_a_turn(tmp_path, yaw):
    """The outline is the same both ways; 20 mm of filling leave the ledge bare, 50 mm higher."""
    tub = stepped_box(at_end_only=True)
    taught = teach_from_mesh(written(tmp_path, tub.solid()))
    pose = (0.02, -0.01, yaw)
    meshes, _ = tub.meshes(0.15, pose)
    scene, _ = tub.scene(0.15, pose)
    plane = trimesh.creation.box((1.0, 1.0, 0.01)).apply_translation([0, 0, -0.005])
    everything = trimesh.util.concatenate(
        [plane, *(trimesh.Trimesh(mesh.vertices, mesh.triangles) for mesh in meshes)])
    surface = FusedSurface(Mesh(everything.vertices.astype(np.float32),
                                everything.faces.astype(np.int32)))
    region = Region(np.array([-0.3, -0.3, -0.03]), np.array([0.3, 0.3, 0.2]), 0.0, 0.0003)
    container = place_container(taught, surface, scene.views(6, radius=0.75), region, 0.002,
                                ReconstructorConfig(container="tub"))
    inner = map_rim_opening(container, 0.002).inner
    c, s = np.cos(yaw), np.sin(yaw)
    ledge = np.array([c, s]) * -0.144 + pose[:2]
    T = geometry.inverse(inner.T_world_map)
    col, row, _ = geometry.apply(T, np.array([*ledge, 0.0])) / inner.pitch
    assert inner.heights[int(row), int(col)] == pytest.approx(FLOOR + 0.07, abs=1e-3)


def test_another_axis_may_be_up(tmp_path):
    path = written(tmp_path, drafted_box().solid(), turn="-x")
    with pytest.raises(MeshError, match="z being up; expected an open .*--up=-x$"):
        teach_from_mesh(path)
    assert teach_from_mesh(path, up="-x").rim_m == pytest.approx(0.123, abs=1e-5)


def test_a_tilted_file_is_refused(tmp_path):
    solid = drafted_box().solid()
    solid.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(5), [1, 0, 0]))
    with pytest.raises(MeshError, match="level rim on .* of its outline, less than 75%, z being "
                                        "up; .* standing level"):
        teach_from_mesh(written(tmp_path, solid))


def test_what_is_no_open_container_is_refused(tmp_path):
    block = trimesh.creation.box((0.3, 0.2, 0.1))
    with pytest.raises(MeshError, match="closed at the top, z being up; .*without lid and conte"):
        teach_from_mesh(written(tmp_path, block))
    tube = trimesh.creation.annulus(0.1, 0.104, height=0.1)
    with pytest.raises(MeshError, match="open below on 9.% of its opening; .* with a floor"):
        teach_from_mesh(written(tmp_path, tube))
    content = trimesh.creation.box((0.02, 0.02, 0.02)).apply_translation([0, 0, 0.05])
    with pytest.raises(MeshError, match="2 bodies; expected 1: the container alone, without lid"):
        teach_from_mesh(written(tmp_path, trimesh.util.concatenate([drafted_box().solid(),
                                                                    content])))
    dish = Tub([(0.115, circle(0.1)), (0.12, circle(0.1))],
               [(0.0, circle(0.104)), (0.12, circle(0.104))])
    with pytest.raises(MeshError, match="5.0 mm deep; expected 6 mm"):
        teach_from_mesh(written(tmp_path, dish.solid()))


@pytest.mark.parametrize("scale, unit, likely", [
    (1.0, "mm", r"m \(.* mm\)"), (1000.0, "m", r"mm \(.* mm\)"), (1000 / 25.4, "mm", "in ")])
def test_the_likely_unit_is_named(tmp_path, scale, unit, likely):
    path = written(tmp_path, drafted_box().solid(), scale=scale)
    with pytest.raises(MeshError, match=f"expected 40 to 2000 mm; its unit may be .*{likely}"):
        teach_from_mesh(path, unit)


def test_drain_holes_are_floor(tmp_path):
    tub = drafted_box(degrees=0.0)
    plate = trimesh.boolean.difference([tub.solid(), trimesh.creation.cylinder(0.005, 0.1)],
                                       engine="manifold")
    taught = teach_from_mesh(written(tmp_path, plate))
    assert sample_heights(taught.inner_map, np.zeros(2)) == pytest.approx(FLOOR, abs=1e-5)
