# SPDX-License-Identifier: Apache-2.0
"""What stereo leaves out is filled in by the depth of single pictures, scaled to stereo's."""

import numpy as np
import pytest
import torch

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import WeightsError
from stack_counter.multiview.monocular import SETTINGS, fill_depth, load_nearness
from stack_counter.pipeline import StackCounter
from stack_counter.types import BACKGROUND, PARTS, Intrinsics, View

CAMERA = Intrinsics(80, 60, 80.0, 80.0, 39.5, 29.5)
Y, X = np.mgrid[:60, :80]
TRUE = (0.5 + 0.001 * X + 0.03 * np.sin(Y / 5)).astype(np.float32)  # metres


def view(measured, labels=None):
    labels = np.full(TRUE.shape, PARTS, np.uint8) if labels is None else labels
    return View(1, CAMERA, np.eye(4), color=np.zeros((*TRUE.shape, 3), np.uint8),
                depth=np.where(measured, TRUE, 0).astype(np.float32), labels=labels)


def nearness_of(depth):
    """As a network gives it: the inverse of depth, from 0 to 1."""
    inverse = 1 / depth
    return ((inverse - inverse.min()) / np.ptp(inverse)).astype(np.float32)


def test_a_hole_is_filled_to_a_thousandth_though_a_tenth_of_stereo_is_wrong():
    hole = (X > 30) & (X < 45)
    scan = view(~hole)
    scan.depth[(X % 10 == 0) & ~hole] *= 1.2
    filled, = fill_depth([scan], lambda color: nearness_of(TRUE))
    assert filled.depth[hole] == pytest.approx(TRUE[hole], rel=1e-3)
    assert np.array_equal(filled.depth[~hole], scan.depth[~hole])


def test_background_stays_unknown():
    labels = np.where(X < 60, PARTS, BACKGROUND).astype(np.uint8)
    scan = view(X < 50, labels)
    filled, = fill_depth([scan], lambda color: nearness_of(TRUE))
    assert np.all(filled.depth[X >= 60] == 0) and filled.depth[(X >= 50) & (X < 52)].all()


def test_depth_far_beyond_what_stereo_measured_is_left_out():
    far = np.where(X >= 60, 2.0, TRUE)
    filled, = fill_depth([view(X < 60)], lambda color: nearness_of(far))
    assert np.all(filled.depth[X >= 60] == 0)


@pytest.mark.parametrize("nearness", [
    np.random.default_rng(0).uniform(size=TRUE.shape).astype(np.float32),
    1 - nearness_of(TRUE), np.zeros_like(TRUE)], ids=["noise", "inside out", "level"])
def test_what_disagrees_with_stereo_fills_nothing(nearness):
    scan = view(X < 60)
    assert fill_depth([scan], lambda color: nearness)[0] is scan


def test_too_little_stereo_gives_no_scale():
    scan = view((X < 20) & (Y < 20))
    assert np.count_nonzero(scan.depth) < SETTINGS.fewest_pixels
    assert fill_depth([scan], lambda color: nearness_of(TRUE))[0] is scan


def test_random_weights_of_a_tiny_network_fill_nothing(tmp_path):
    transformers = pytest.importorskip("transformers", reason="needs the extra models")
    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, patch_size=14, image_size=518,
        out_indices=[1, 2, 3, 4], apply_layernorm=True, reshape_hidden_states=False)
    transformers.DepthAnythingForDepthEstimation(transformers.DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, head_hidden_size=4)).save_pretrained(tmp_path)
    scan = view(X < 60)
    scan.color[:] = np.random.default_rng(0).integers(0, 255, scan.color.shape)
    assert fill_depth([scan], load_nearness(tmp_path))[0] is scan
    StackCounter(ReconstructorConfig(depth_weights=str(tmp_path)))


def test_a_folder_without_weights_is_refused_before_any_view():
    with pytest.raises(WeightsError, match="no folder /nowhere"):
        StackCounter(ReconstructorConfig(depth_weights="/nowhere"))
