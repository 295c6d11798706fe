# SPDX-License-Identifier: Apache-2.0
"""Rendered depth and labels against closed forms."""

import numpy as np
import pytest
import trimesh
from kits.analytic import Scene as Analytic
from kits.single_part import one_part
from scipy import ndimage

from stack_counter import geometry
from stack_counter.sim.camera.recording import CAMERA
from stack_counter.sim.camera.render import Renderer, camera_rays
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.types import BACKGROUND, CONTAINER, PARTS

SOLIDS = {
    "box": (trimesh.creation.box([0.1, 0.06, 0.04]), 0.02,
            Analytic().box([0, 0, 0.02], [0.1, 0.06, 0.04])),
    "ball": (trimesh.creation.icosphere(5, 0.05), 0.05, Analytic().sphere([0, 0, 0.05], 0.05)),
    "cylinder": (trimesh.creation.cylinder(0.04, 0.06, sections=720), 0.03,
                 Analytic().cylinder(0, 0, 0.04, 0.06)),
}


def away_from_edges(depth):
    steps = np.abs(np.gradient(depth)).max(axis=0) > 0.01
    return ~ndimage.binary_dilation(steps, iterations=2)


@pytest.mark.parametrize("name", SOLIDS)
def test_depth_is_that_of_the_closed_form(name):
    mesh, z, analytic = SOLIDS[name]
    T = geometry.look_at(np.array([0.2, -0.15, 0.5]), np.array([0.0, 0, 0.02]))
    depth, labels = Renderer(one_part(mesh, z)).render_depth_and_labels(CAMERA, T)
    want = analytic.view(T).depth
    assert np.abs(depth - want)[away_from_edges(want)].max() < 1e-4
    # Pixel centres: the outline's middle lies where the closed form has it.
    plane = Analytic().view(T).depth
    middle = [np.array(ndimage.center_of_mass(x)) for x in (labels == PARTS, want < plane - 1e-5)]
    assert np.abs(middle[0] - middle[1]).max() < 0.1


def test_a_filled_bin_is_seen_where_it_stands():
    c, s = np.cos(0.4), np.sin(0.4)
    pose = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.05, -0.02, 0]))
    box = ContainerShape("bin", pose, (0.2, 0.14, 0.1), 0.01, 0.008)
    scene = one_part(trimesh.creation.box([0.2, 0.14, 0.06]), 0.008 + 0.03, box)
    T = geometry.look_at(np.array([0.25, -0.1, 0.6]), np.array([0.05, -0.02, 0.05]))
    depth, labels = Renderer(scene).render_depth_and_labels(CAMERA, T)
    want = Analytic().bin((0.2, 0.14, 0.1), 0.01, 0.008, 0.06, 0.05, -0.02, 0.4).view(T).depth
    assert np.abs(depth - want)[away_from_edges(want)].max() < 1e-4
    assert set(np.unique(labels)) == {BACKGROUND, CONTAINER, PARTS}
    # The parts' top, 0.2 x 0.14 m, is cut by the wall's edge: what shows of it has its height.
    direction = camera_rays(CAMERA, T)[..., 3:][labels == PARTS]
    height = T[2, 3] + depth[labels == PARTS] * direction[:, 2]
    np.testing.assert_allclose(height, 0.068, atol=1e-4)
