# SPDX-License-Identifier: Apache-2.0
"""SAM 2 with a tiny random configuration: loading, shapes, labels, refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits.bags import CAMERA, bin_views
from safetensors.torch import load_file, save_file

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ConfigError, ViewError, WeightsError
from stack_counter.pipeline import StackCounter
from stack_counter.segmentation.prompts import PromptError, parse_prompts
from stack_counter.segmentation.sam2 import Sam2Segmenter, _label_image
from stack_counter.types import CONTAINER, PARTS

transformers = pytest.importorskip("transformers", reason="SAM 2 needs the extra models")

PROMPTS = parse_prompts({"parts": {"boxes": [[60, 45, 100, 80]], "points": [[80, 60]]},
                         "container": {"boxes": [[40, 30, 120, 95]]},
                         "background": {"points": [[5, 5]]}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from kits.tiny_models import save_sam2

    return save_sam2(tmp_path_factory.mktemp("sam2"))


def test_labels_every_view(folder):
    views = bin_views()[:3]
    small = replace(CAMERA, width=100, height=90)  # as a view cut to the region of interest
    views[2] = replace(views[2], intrinsics=small, color=views[2].color[:90, :100], depth=None)
    labels = Sam2Segmenter(folder).segment_views(views, PROMPTS)
    assert [image.shape for image in labels] == [(120, 160), (120, 160), (90, 100)]
    assert all(image.dtype == np.uint8 and set(np.unique(image)) <= {0, 1, 2} for image in labels)


def test_parts_win_over_the_container_that_holds_them():
    inside, outside = np.full((4, 4), -3, np.float32), np.full((4, 4), 5, np.float32)
    inside[:, :2] = 1
    labels = _label_image({CONTAINER: outside, PARTS: inside}, bin_views()[0])
    assert labels.shape == (120, 160)
    assert np.all(labels[:, :60] == PARTS) and np.all(labels[:, 100:] == CONTAINER)


def test_prompts_and_views_that_do_not_fit(folder):
    model, views = Sam2Segmenter(folder), bin_views()[:2]
    with pytest.raises(PromptError, match="outside of the 160x120 image"):
        model.segment_views(views, parse_prompts({"parts": {"points": [[161, 3]]}}))
    with pytest.raises(ViewError, match="no_color"):
        model.segment_views([views[0], replace(views[1], color=None)], PROMPTS)


def copied(folder, out):
    for path in folder.iterdir():
        (out / path.name).write_bytes(path.read_bytes())
    return out


def test_folders_that_hold_no_such_model(folder, tmp_path):
    with pytest.raises(WeightsError, match="no folder .*none"):
        Sam2Segmenter(tmp_path / "none")
    with pytest.raises(WeightsError, match="no config.json"):
        Sam2Segmenter(tmp_path)
    copied(folder, tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "model_type": "sam"}))
    with pytest.raises(WeightsError, match="model type 'sam'; expected 'sam2_video'"):
        Sam2Segmenter(tmp_path)


def test_weights_are_safetensors_and_whole(folder, tmp_path):
    weights = copied(folder, tmp_path) / "model.safetensors"
    tensors = load_file(weights)
    gone = sorted(tensors)[3]
    del tensors[gone]
    save_file(tensors, weights, {"format": "pt"})
    with pytest.raises(WeightsError, match="lacks 1 tensors"):
        Sam2Segmenter(tmp_path)
    weights.write_bytes(weights.read_bytes()[:2000])
    with pytest.raises(WeightsError, match="cannot be loaded"):
        Sam2Segmenter(tmp_path)
    weights.rename(tmp_path / "pytorch_model.bin")
    with pytest.raises(WeightsError, match="no .safetensors"):
        Sam2Segmenter(tmp_path)


def test_the_pipeline_labels_by_sam2(folder):
    stack = StackCounter(ReconstructorConfig(segmenter="sam2", sam2_weights=str(folder),
                                             prompts="{parts: {points: [[80, 60]]}}"))
    views = bin_views()[:3]
    for view in views:
        stack.add_view(view)
    stack.volume()
    labelled = stack.labelled_views()
    assert len(labelled) == 3
    assert all(view.labels.shape == view.depth.shape for view in labelled)
    with pytest.raises(ConfigError, match="sam2_weights is empty"):
        StackCounter(ReconstructorConfig(segmenter="sam2", prompts="{parts: {points: [[1, 2]]}}"))
