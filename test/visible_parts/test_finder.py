# SPDX-License-Identifier: Apache-2.0
"""From a reconstruction to parts in the world, by a network that is a rule."""


import numpy as np
import pytest
import trimesh
from kits.known_parts import ConstantEstimator
from kits.part_weights import SHARE_TOLD, write_part_weights
from safetensors.numpy import save_file
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.errors import PartError, WeightsError
from stack_counter.parts.catalogue import Part
from stack_counter.stack_count import count_stack
from stack_counter.types import Container, HeightMap, StackVolume, ViewTally
from stack_counter.visible_parts.finder import FORMAT, VisiblePartFinder, make_finder

LENGTH, PITCH = 0.02, 0.002
CUBES = [(0.03, 0.05), (0.09, 0.03), (0.07, 0.11)]  # x and y of their middles in the map, metres


@pytest.fixture(scope="module")
def finder(tmp_path_factory):
    return VisiblePartFinder(write_part_weights(tmp_path_factory.mktemp("w") / "w.safetensors"))


def stack(cubes=CUBES, T_world_map=np.eye(4), height=LENGTH):
    """The volume of cubes on a level floor 5 mm above the support plane."""
    heights = np.full((70, 60), 0.005, np.float32)
    rows, cols = np.indices(heights.shape)
    for x, y in cubes:
        on = np.maximum(np.abs((cols + 0.5) * PITCH - x), np.abs((rows + 0.5) * PITCH - y))
        heights[on < LENGTH / 2] = 0.005 + height
    top = HeightMap(T_world_map, PITCH, heights)
    inner = HeightMap(T_world_map, PITCH, np.full_like(heights, 0.005))
    return StackVolume(0, len(cubes) * LENGTH**3, 0.0, Container("box", np.eye(4)), (0, 0, 0),
                       1.0, top, inner, None, ViewTally())


def test_cubes_are_found_where_they_are_in_the_world(finder):
    T = geometry.pose(Rotation.from_euler("z", 0.4).as_matrix(), np.array([1.0, -2.0, 0.7]))
    parts = finder.find(stack(T_world_map=T), LENGTH**3)
    expected = geometry.apply(T, np.array([[x, y, 0.005 + LENGTH] for x, y in CUBES]))
    places = np.array(sorted(p.position.tolist() for p in parts))
    assert places == pytest.approx(np.array(sorted(expected.tolist())), abs=0.001)
    for part in parts:
        local = geometry.apply(geometry.inverse(T), part.outline)
        assert np.ptp(local[:, :2], axis=0) == pytest.approx(LENGTH - PITCH, abs=1.5 * PITCH)
        assert np.ptp(local[:, 2]) == pytest.approx(0, abs=1e-9)
        assert part.share_visible == pytest.approx(SHARE_TOLD) and 0.5 <= part.score <= 1
    assert [p.score for p in parts] == sorted((p.score for p in parts), reverse=True)


def test_the_same_parts_of_another_size_are_found_alike(finder):
    """Ten times as large: the network reads lengths in parts."""
    small = stack()
    large = stack()
    large = StackVolume(**{**vars(large), **{
        name: HeightMap(np.eye(4), 10 * PITCH, 10 * getattr(small, name).heights)
        for name in ("top", "inner")}})
    of_small, of_large = finder.find(small, LENGTH**3), finder.find(large, (10 * LENGTH) ** 3)
    assert np.array([p.position for p in of_large]) == pytest.approx(
        10 * np.array([p.position for p in of_small]), abs=1e-6)


def test_an_empty_floor_shows_none(finder):
    assert finder.find(stack(cubes=[]), LENGTH**3) == ()


def test_what_cannot_be_read_gives_none(finder):
    volume = stack()
    assert finder.find(StackVolume(**{**vars(volume), "top": None}), LENGTH**3) is None
    assert finder.find(volume, 1e-12) is None  # too small beside the surface


def test_the_shipped_file_serves_unless_another_is_named(tmp_path):
    assert isinstance(make_finder(), VisiblePartFinder)
    write_part_weights(tmp_path / "own.safetensors")
    assert isinstance(make_finder(str(tmp_path / "own.safetensors")), VisiblePartFinder)
    with pytest.raises(WeightsError, match="no weights file"):
        make_finder(str(tmp_path / "missing.safetensors"))


def test_a_file_without_a_threshold_is_refused(tmp_path):
    save_file({"a": np.zeros(1, np.float32)}, tmp_path / "w.safetensors",
              metadata={"format": FORMAT})
    with pytest.raises(WeightsError, match="no threshold"):
        VisiblePartFinder(tmp_path / "w.safetensors")


def test_a_count_carries_them_where_there_is_a_finder(finder):
    volume, part = stack(), Part(LENGTH**3)
    count = count_stack(volume, part, ConstantEstimator(1.0), 0.9, finder=finder)
    assert len(count.visible_parts) == count.count == 3 and "visible_parts" in count.seconds
    alone = count_stack(volume, part, ConstantEstimator(1.0), 0.9)
    assert alone.visible_parts is None and "visible_parts" not in alone.seconds
    assert (alone.count, alone.count_interval) == (count.count, count.count_interval)
    unread = StackVolume(**{**vars(volume), "top": None})
    assert count_stack(unread, part, ConstantEstimator(1.0), 0.9,
                       finder=finder).visible_parts is None


def test_the_best_parts_of_a_count_have_poses_where_the_part_has_a_mesh(finder, tmp_path):
    T = geometry.pose(Rotation.from_euler("z", 0.4).as_matrix(), np.array([1.0, -2.0, 0.7]))
    volume, mesh = stack(T_world_map=T), tmp_path / "cube.stl"
    trimesh.creation.box((1000 * LENGTH,) * 3).apply_translation((9, 0, 0)).export(mesh)  # mm
    part = Part(LENGTH**3, "cube", mesh=mesh)
    posing = VisiblePartFinder(write_part_weights(tmp_path / "w.safetensors"), poses=2)
    parts = count_stack(volume, part, ConstantEstimator(1.0), 0.9, finder=posing).visible_parts
    posed = [p for p in parts if p.pose is not None]
    assert len(posed) == 2 and len(parts) == 3
    for found in posed:
        middle = geometry.apply(found.pose.T_world_part, np.array([0.009, 0, 0]))
        assert middle[:2] == pytest.approx(found.position[:2], abs=0.002)
        assert middle[2] == pytest.approx(0.705 + LENGTH / 2, abs=0.002)
        assert found.pose.fit > 0.7
    for no_poses in ((part, finder), (Part(LENGTH**3), posing)):
        count = count_stack(volume, no_poses[0], ConstantEstimator(1.0), 0.9, finder=no_poses[1])
        assert [p.pose for p in count.visible_parts] == [None] * 3


def test_a_mesh_that_cannot_be_read_is_an_error_where_poses_are_asked_for(finder, tmp_path):
    posing = VisiblePartFinder(write_part_weights(tmp_path / "w.safetensors"), poses=2)
    gone = Part(LENGTH**3, "cube", mesh=tmp_path / "gone.stl")
    with pytest.raises(PartError, match=r"mesh of part 'cube'.*gone.stl"):
        count_stack(stack(), gone, ConstantEstimator(1.0), 0.9, finder=posing)
    assert count_stack(stack(), gone, ConstantEstimator(1.0), 0.9, finder=finder).count == 3
    trimesh.creation.box((5, 5, 5)).export(gone.mesh)
    with pytest.raises(PartError, match="expected 8 cm3"):
        count_stack(stack(), gone, ConstantEstimator(1.0), 0.9, finder=posing)


def test_an_empty_bin_shows_none_whatever_its_floor_looks_like(finder):
    volume = StackVolume(**{**vars(stack()), "stack_volume": 0.0})
    count = count_stack(volume, Part(LENGTH**3), ConstantEstimator(1.0), 0.9, finder=finder)
    assert count.count == 0 and count.visible_parts == ()
