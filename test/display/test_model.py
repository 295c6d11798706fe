# SPDX-License-Identifier: Apache-2.0
"""The 3D model of a report and its picture, against what was put in."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from kits.counted_bin import FLOOR, INNER, container, counted_bin

from stack_counter.display.page import surfaces
from stack_counter.display.page.model import build_glb, linear_colors
from stack_counter.display.page.poster import SETTINGS as POSTER
from stack_counter.display.page.poster import draw_poster
from stack_counter.types import Container, Mesh

RIM = FLOOR + INNER[2]


def shown(count):
    return {"surface": surfaces.surface_to_show(count.volume),
            "container": surfaces.container_to_show(count.volume)}


def test_the_model_has_y_up_linear_colours_and_no_metal():
    scene = trimesh.load(io.BytesIO(build_glb(shown(counted_bin()))), file_type="glb")
    surface, bars = scene.geometry["surface"], scene.geometry["container"]
    assert surface.bounds[:, 1] == pytest.approx([FLOOR, RIM], abs=0.001)
    assert bars.extents == pytest.approx([INNER[0], INNER[2], INNER[1]], abs=0.01)
    material = surface.visual.material
    assert material.metallicFactor == 0 and material.doubleSided
    colors = surface.visual.vertex_attributes["color"]
    assert {tuple(color) for color in colors[:, :3]} == {(147, 3, 3), (3, 3, 147)}


def test_linear_colours_are_those_of_the_standard():
    linear = linear_colors(np.array([[0, 255, 128]], np.uint8))
    assert linear.tolist() == [[0, 255, 55, 255]]  # 128 / 255 is 0.2159


def test_bars_run_along_rim_floor_and_corners():
    bars = surfaces.container_to_show(counted_bin().volume)
    assert len(bars.vertices) == 8 * 12
    assert trimesh.Trimesh(bars.vertices, bars.triangles).volume > 0
    for name, z in (("rim", RIM), ("floor", FLOOR)):
        near = np.abs(bars.vertices[:, 2] - z) < 0.004
        assert near.sum() >= 32, name
        assert np.ptp(bars.vertices[near, 0]) == pytest.approx(INNER[0], abs=0.006)


def test_a_container_without_rings_is_drawn_by_the_map_of_its_inner_surface():
    volume = counted_bin(container=replace(container(), rings=None)).volume
    rings = surfaces.container_rings(volume)
    assert rings[..., 2].max() == pytest.approx(RIM) and rings[..., 2].min() == FLOOR
    assert np.ptp(rings[0], axis=0)[:2] == pytest.approx(INNER[:2], abs=0.006)
    assert surfaces.container_to_show(counted_bin(container=Container("none", np.eye(4))).volume) \
        is None


def test_most_triangles_are_spent_over_the_stack(monkeypatch):
    """A wide plane around the bin does not take them, and what is far away is left out."""
    rows, cols = np.mgrid[-60:61, -60:61]
    plane = np.stack([cols * 0.02, rows * 0.02, 0 * rows], axis=-1).reshape(-1, 3)
    index = np.arange(rows.size).reshape(rows.shape)
    triangles = np.column_stack([index[:-1, :-1].ravel(), index[:-1, 1:].ravel(),
                                 index[1:, 1:].ravel()])
    count = counted_bin()
    surface = count.volume.mesh
    mesh = Mesh(np.concatenate([surface.vertices, plane]).astype(np.float32), np.concatenate(
        [surface.triangles, triangles + len(surface.vertices)]).astype(np.int32))
    got = surfaces.surface_to_show(replace(count.volume, mesh=mesh))
    assert np.abs(got.vertices[:, :2]).max() < 0.2 and got.vertices[:, 2].min() == 0
    assert len(got.triangles) > len(surface.triangles)
    monkeypatch.setattr(surfaces, "SETTINGS", replace(
        surfaces.SETTINGS, max_triangles=500, max_triangles_around=50))
    few = surfaces.surface_to_show(replace(count.volume, mesh=mesh))
    assert 100 < len(few.triangles) <= 550


def test_points_of_a_hull_become_cubes():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    hull = surfaces.surface_to_show(counted_bin(
        mesh=Mesh(points, np.zeros((0, 3), np.int32))).volume)
    assert len(hull.triangles) == 36
    assert trimesh.Trimesh(hull.vertices, hull.triangles).volume == pytest.approx(3 / 60**3)
    many = np.random.default_rng(0).random((20_000, 3)).astype(np.float32)
    cubes = surfaces.surface_to_show(counted_bin(
        mesh=Mesh(many, np.zeros((0, 3), np.int32))).volume)
    assert len(cubes.triangles) <= 12 * surfaces.SETTINGS.max_voxels


def test_the_relief_has_the_colours_of_the_key_view_where_that_shows_it():
    count = counted_bin(mesh=None)
    relief = surfaces.surface_to_show(count.volume)
    assert relief.vertices[:, 2].max() == pytest.approx(RIM, abs=0.002)
    middle = np.abs(relief.vertices[:, 0]) < 0.01  # the slope's middle lies 0.55 m below the eye
    assert (relief.colors[middle] == (180, 140, 90)).all(axis=1).mean() > 0.7


def test_the_poster_shows_left_at_the_left_and_nothing_in_its_corners():
    poster = draw_poster([shown(counted_bin())["surface"]], 0.0)
    assert poster.shape == (*POSTER.size_px[::-1], 4)
    assert poster[0, 0, 3] == poster[-1, -1, 3] == 0
    opaque = poster[..., 3] == 255
    assert 0.2 < opaque.mean() < 0.8
    columns = np.arange(poster.shape[1])[None].repeat(len(poster), axis=0)
    red = opaque & (poster[..., 2] > poster[..., 0])
    assert columns[red].mean() < columns[opaque & ~red].mean()
    turned = draw_poster([shown(counted_bin())["surface"]], np.pi)
    red = (turned[..., 3] == 255) & (turned[..., 2] > turned[..., 0])
    assert columns[red].mean() > turned.shape[1] / 2
