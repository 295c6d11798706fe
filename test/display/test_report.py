# SPDX-License-Identifier: Apache-2.0
"""Pictures and files of a report, against what was put in."""

from dataclasses import replace

import numpy as np
import open3d as o3d
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.display.mesh_colors import color_mesh, display_colors
from stack_counter.display.report import draw_container, write_ply
from stack_counter.pipeline import StackCounter
from stack_counter.types import Mesh

INNER = (0.3, 0.2, 0.12)


def painted_views():
    """A bin whose pictures are red left of x = 0 and blue right of it."""
    views = Scene().bin(INNER, 0.005, 0.005, 0.07).views(8)
    out = []
    for view in views:
        x = geometry.apply(view.T_world_camera, geometry.unproject(view.depth, view.intrinsics))
        color = np.where(x[..., :1] < 0, [255, 0, 0], [0, 0, 255]).astype(np.uint8)
        out.append(replace(view, color=color))
    return out


def reconstruct(views):
    stack = StackCounter(ReconstructorConfig())
    for view in views:
        stack.add_view(view)
    return stack.volume()


def test_a_mesh_takes_the_colour_of_its_place():
    mesh = reconstruct(painted_views()).mesh
    seen = np.ptp(mesh.colors.astype(int), axis=1) > 0
    left, right = (seen & (sign * mesh.vertices[:, 0] > 0.01) for sign in (-1, 1))
    assert seen.mean() > 0.9
    assert np.mean(mesh.colors[left, 0] > mesh.colors[left, 2]) > 0.99
    assert np.mean(mesh.colors[right, 2] > mesh.colors[right, 0]) > 0.99


def test_views_without_colour_leave_a_mesh_as_it_was():
    mesh = Mesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32))
    assert color_mesh(mesh, Scene().views(2)).colors is None


def test_a_mesh_without_colours_is_shown_by_height():
    vertices = np.array([[0, 0, 0.5], [1, 0, 0.1], [0, 1, 0.3]], np.float32)
    colors = display_colors(Mesh(vertices, np.array([[0, 1, 2]], np.int32)))
    assert colors[1].tolist() == [68, 1, 84] and colors[0].tolist() == [253, 231, 37]  # viridis
    own = np.array([[1, 2, 3]] * 3, np.uint8)
    assert display_colors(Mesh(vertices, np.array([[0, 1, 2]], np.int32), own)) is own


def test_ply_is_read_back_the_same(tmp_path):
    random = np.random.default_rng(0)
    mesh = Mesh(random.random((5, 3)).astype(np.float32),
                np.array([[0, 1, 2], [2, 3, 4]], np.int32),
                random.integers(0, 255, (5, 3)).astype(np.uint8))
    write_ply(tmp_path / "m.ply", mesh)
    read = o3d.t.io.read_triangle_mesh(str(tmp_path / "m.ply"))
    assert np.array_equal(read.vertex.positions.numpy(), mesh.vertices)
    assert np.array_equal(read.triangle.indices.numpy(), mesh.triangles)
    assert np.array_equal(np.round(255 * read.vertex.colors.numpy()), mesh.colors)


def test_the_rim_is_drawn_where_it_is_seen():
    volume = reconstruct(painted_views())
    picture = draw_container(volume.key_view, volume.container)
    rim = geometry.apply(volume.container.T_world_container, volume.container.rings[-1])
    pixels, _ = geometry.project(
        geometry.apply(geometry.inverse(volume.key_view.T_world_camera), rim),
        volume.key_view.intrinsics)
    height, width = picture.shape[:2]
    inside = [(x, y) for x, y in np.round(2 * pixels + 0.5).astype(int)
              if 2 < x < width - 2 and 2 < y < height - 2]
    for x, y in inside:
        assert (picture[y - 2:y + 3, x - 2:x + 3] == (0, 0, 255)).all(axis=-1).any()
