# SPDX-License-Identifier: Apache-2.0
"""Count, V and gamma of scenes whose truth has a closed form."""

import numpy as np
import pytest
import trimesh

from stack_counter import geometry
from stack_counter.sim import Scene
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.truth import TruthSettings, sample_inside
from stack_counter.sim.shapes import Shape

INNER, FLOOR = (0.2, 0.14, 0.1), 0.004
HEAP = ContainerShape("none", inner_size_m=(1.0, 1.0, 0.0))


def box(kind="bin", inner=INNER, draft=0.0, T=np.eye(4)):
    return ContainerShape(kind, T, inner, 0.003, FLOOR, draft)


def scene(mesh, places, container=HEAP):
    """Parts of one mesh, centred on its centre of mass, unturned; `places` (n, 3) of its centre
    in the container's frame."""
    shape = Shape("test", mesh.vertices - mesh.center_mass, np.asarray(mesh.faces, np.int32))
    places = np.reshape(np.array(places, float), (-1, 3))
    return Scene(0, 0, shape, container,
                 np.concatenate([places, np.tile([0, 0, 0, 1.0], (len(places), 1))], axis=1))


def yaw(angle, x, y):
    c, s = np.cos(angle), np.sin(angle)
    return geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, y, 0.0]))


def test_a_filled_box_is_its_content():
    truth = scene(trimesh.creation.box([0.2, 0.14, 0.08]), [0, 0, FLOOR + 0.04], box()).truth
    assert truth.stack_volume == pytest.approx(0.2 * 0.14 * 0.08, rel=0.005)
    assert truth.gamma == pytest.approx(1, rel=0.005) and truth.count == 1
    assert truth.fill == pytest.approx(0.8, rel=0.005)
    assert truth.unit_volume == pytest.approx(0.2 * 0.14 * 0.08)


@pytest.mark.parametrize("height, whole, center", [
    (0.10, 1.0, 1.0), (0.075, 0.75, 1.0), (0.05, 0.5, 0.5), (0.025, 0.25, 0.0)])
def test_ratios_with_and_without_borders_of_a_box_filled_in_part(height, whole, center,
                                                                 monkeypatch):
    # The central box reaches from a quarter of the depth to three quarters. The points that stand
    # for a part are made for small ones: in a part as large as the bin there must be more.
    monkeypatch.setattr("stack_counter.sim.scenes.truth.SETTINGS",
                        TruthSettings(points_per_part=100_000))
    block = trimesh.creation.box([0.2, 0.14, height])
    truth = scene(block, [0, 0, FLOOR + height / 2], box()).truth
    assert truth.gamma_whole == pytest.approx(whole, rel=1e-3)
    assert truth.gamma_center == pytest.approx(center, abs=0.06)
    assert truth.gamma == pytest.approx(1, rel=0.005)


def test_the_ratio_without_borders_of_many_small_blocks_is_sharp():
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in (10, 7, 3)], indexing="ij"), -1)
    places = (grid.reshape(-1, 3) + 0.5) * 0.02 - [0.1, 0.07, -FLOOR]
    truth = scene(trimesh.creation.box([0.02] * 3), places, box()).truth
    assert truth.count == 210
    assert truth.gamma_whole == pytest.approx(0.6, rel=1e-3)
    assert truth.gamma_center == pytest.approx((0.06 - 0.025) / 0.05, rel=0.05)
    # Every other block away: half of gamma, but the view from above still sees all full.
    sparse = scene(trimesh.creation.box([0.02] * 3), places[grid.reshape(-1, 3)[:, 2] != 1],
                   box()).truth
    assert sparse.stack_volume == pytest.approx(truth.stack_volume, rel=1e-6)
    assert sparse.gamma == pytest.approx(2 / 3, rel=0.005)


def test_a_cylinder_filled_by_a_cylinder():
    part = trimesh.creation.cylinder(0.05, 0.03, sections=720)
    truth = scene(part, [[0, 0, FLOOR + 0.015], [0, 0, FLOOR + 0.045]],
                  box("cylinder", (0.1, 0.1, 0.09))).truth
    assert truth.stack_volume == pytest.approx(np.pi * 0.05**2 * 0.06, rel=0.005)
    assert truth.gamma == pytest.approx(1, rel=0.005)
    assert truth.gamma_whole == pytest.approx(2 / 3, rel=0.005)


def test_a_bin_with_draft_is_a_prismatoid():
    slope, depth = 0.25, INNER[2]

    def outline(up):  # x, y at a height over the inner floor
        return np.array(INNER[:2]) - 2 * slope * (depth - up)

    def prismatoid(up):
        return up / 6 * sum(w * np.prod(outline(u)) for w, u in ((1, 0), (4, up / 2), (1, up)))

    up = 0.06
    corners = [[*(np.array(sign) * outline(z) / 2), z] for z in (0, up)
               for sign in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    part = trimesh.convex.convex_hull(np.array(corners))
    assert part.volume == pytest.approx(prismatoid(up))
    z = FLOOR + part.center_mass[2]
    truth = scene(part, [0, 0, z], box(draft=np.arctan(slope))).truth
    assert truth.stack_volume == pytest.approx(prismatoid(up), rel=0.005)
    assert truth.gamma == pytest.approx(1, rel=0.005)
    # The whole inside: what gamma_whole divides by.
    assert truth.unit_volume / truth.gamma_whole == pytest.approx(prismatoid(depth), rel=0.005)


def test_a_bowls_whole_inside_in_closed_form():
    # Integral of pi R^2 (1 - k u^2) over the depth, k = 1 - 0.35^2; its mesh is 48 by 8 chords.
    truth = scene(trimesh.creation.box([0.02] * 3), [0, 0, FLOOR + 0.01],
                  box("bowl", (0.2, 0.2, 0.08))).truth
    want = np.pi * 0.1**2 * 0.08 * (1 - (1 - 0.35**2) / 3)
    assert truth.unit_volume / truth.gamma_whole == pytest.approx(want, rel=0.01)


def test_a_ball_on_the_plane_fills_its_undercut():
    ball = trimesh.creation.icosphere(5, 0.05)
    want = 4 / 6 * np.pi * 0.05**3 + np.pi * 0.05**3  # upper half, and the cylinder below it
    # 20 cells across are a coarse circle.
    truth = scene(ball, [0, 0, 0.05]).truth
    assert truth.stack_volume == pytest.approx(want, rel=0.01)
    assert np.isnan(truth.gamma_whole) and np.isnan(truth.gamma_center)
    assert truth.fill == pytest.approx(want / 0.1**2 / 0.1, rel=0.01)  # over its bounding box


@pytest.mark.parametrize("container", [box(), HEAP], ids=["bin", "heap"])
def test_an_empty_scene_has_no_volume(container):
    truth = scene(trimesh.creation.box([0.02] * 3), np.zeros((0, 3)), container).truth
    assert truth.count == 0 and truth.stack_volume == 0 and truth.fill == 0
    assert np.isnan(truth.gamma)
    if container is not HEAP:
        assert truth.gamma_whole == 0 and truth.gamma_center == 0


def test_what_hangs_over_the_rim_counts_in_the_number_not_in_the_volume():
    beam = trimesh.creation.box([0.08, 0.06, 0.02])  # from 0.06 to 0.14; the rim is at 0.1
    rim = FLOOR + INNER[2]
    truth = scene(beam, [0.1, 0, rim + 0.01], box()).truth
    assert truth.count == 1 and truth.unit_volume == pytest.approx(0.08 * 0.06 * 0.02)
    # Half of the beam, and everything under it down to the floor.
    assert truth.stack_volume == pytest.approx(0.04 * 0.06 * (INNER[2] + 0.02), rel=1e-3)
    outside = scene(beam, [0.2, 0, 0.01], box()).truth
    assert outside.count == 1 and outside.stack_volume == 0


@pytest.mark.parametrize("kind", ["bin", "bag", "bowl", "none"])
def test_truth_does_not_depend_on_where_the_container_stands(kind):
    random = np.random.default_rng(0)
    places = random.uniform([-0.06, -0.04, 0.02], [0.06, 0.04, 0.09], (25, 3))
    part = trimesh.creation.box([0.03, 0.02, 0.01])
    truths = []
    for T in (np.eye(4), yaw(0.7, 0.3, -0.2), yaw(-2.5, -0.1, 0.4)):
        container = ContainerShape("none", T, (0.4, 0.4, 0.0)) if kind == "none" else box(
            kind, T=T)
        truths.append(scene(part, places, container).truth)
    for other in truths[1:]:
        assert other.stack_volume == pytest.approx(truths[0].stack_volume, rel=2e-3)
        assert other.gamma_center == pytest.approx(truths[0].gamma_center, nan_ok=True)
        assert other.gamma_whole == pytest.approx(truths[0].gamma_whole, rel=1e-3, nan_ok=True)


def test_points_inside_a_part_stand_for_its_volume():
    part = trimesh.creation.annulus(0.008, 0.02, 0.02, sections=64)
    points = sample_inside(Shape("test", part.vertices, np.asarray(part.faces, np.int32)), 4000)
    r = np.linalg.norm(points[:, :2], axis=1)
    assert len(points) == pytest.approx(4000, rel=0.05)
    assert r.min() > 0.0079 and r.max() < 0.02 and np.abs(points[:, 2]).max() < 0.01
