# SPDX-License-Identifier: Apache-2.0
"""Pairs of surfaces: cast where a reconstruction has its cells, stored, and told apart."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import trimesh
from kits.surfaces import stack_volume_of_heights

from stack_counter.train import stereo_surface as command
from stack_counter.train.data.surface_pairs import (
    SurfacePair,
    make_pair,
    read_pairs,
    write_pairs,
)
from stack_counter.train.data.surface_patches import cut_patches
from stack_counter.types import Mesh


def made_pair(seed, blur, family="nut"):
    """A rough surface, and the same blurred."""
    random = np.random.default_rng(seed)
    cast = cv2.GaussianBlur(random.standard_normal((64, 64)), (0, 0), 1.0).astype(np.float32) + 3
    valid = np.ones(cast.shape, bool)
    return SurfacePair(cast, blurred(cast, blur), np.zeros_like(cast), np.ones_like(cast), valid,
                       True, 0.003, 0.02, f"train-deep:{seed}", family)


def blurred(top, sigma):
    return cv2.GaussianBlur(top, (0, 0), sigma)


def test_rays_are_cast_where_the_reconstruction_has_its_cells():
    """A box of 20 mm on the plane; the map begins 10 mm beside its middle."""
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    box.apply_translation((0.02, 0.02, 0.01))
    container = SimpleNamespace(inner_mesh=lambda: None, rim_height_m=0.0)
    scene = SimpleNamespace(
        truth=SimpleNamespace(unit_volume=8e-6), seed=0, index=1, container=container,
        shape=SimpleNamespace(family="cube"),
        parts_mesh=lambda: Mesh(box.vertices.astype(np.float32), box.faces.astype(np.int32)))
    volume = stack_volume_of_heights(np.full((20, 20), 0.015), pitch=0.002, kind="none")
    pair = make_pair(scene, volume, "train-deep:1")
    assert pair.cast.shape == pair.top.shape == (16, 16)  # 40 mm of 2 part lengths
    np.testing.assert_allclose(pair.cast[4:12, 4:12], 1.0, atol=1e-4)
    assert not pair.cast[:4].any() and not pair.walled
    np.testing.assert_allclose(pair.top, 0.75, atol=1e-5)
    assert pair.seen_share[8, 8] == 1


def test_pairs_come_back_from_their_file(tmp_path):
    written = [made_pair(0, 1.0), made_pair(1, 2.0, "tube")]
    write_pairs(tmp_path / "a.npz", written)
    for a, b in zip(written, read_pairs(tmp_path), strict=True):
        np.testing.assert_array_equal(a.cast, b.cast)
        np.testing.assert_array_equal(a.valid, b.valid)
        assert (a.name, a.family, a.walled, a.resolution) == (
            b.name, b.family, b.walled, pytest.approx(b.resolution))


def test_patches_lie_wholly_inside_and_are_heights_over_their_mean():
    top = np.tile(np.arange(64, dtype=np.float32) / 8, (64, 1))
    usable = np.zeros(top.shape, bool)
    usable[8:24, 8:32] = True
    patches = cut_patches(top, usable)
    assert patches.shape == (3, 16, 16)  # steps of 4 pixels over 16 x 24
    np.testing.assert_allclose(patches, np.tile(top[:16, :16] - 15 / 16, (3, 1, 1)), atol=1e-6)
    assert len(cut_patches(top[:9], usable[:9])) == 0


def test_the_fit_comes_nearer(monkeypatch):
    monkeypatch.setattr(command, "SETTINGS", command.FitSettings(evaluations=25))
    targets = [command.target_of(made_pair(i, 2.0)) for i in range(2)]
    fitted = command.fit(targets)
    assert command.mean_distance(fitted, targets) < command.mean_distance(command.SHIPPED, targets)
