# SPDX-License-Identifier: Apache-2.0
"""SAM + CLIP and a vision-language model, on tiny random models saved to disk."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from stack_counter.errors import WeightsError
from stack_counter.picture_baselines import load_baseline, sam_clip
from stack_counter.picture_baselines.picture import Picture
from stack_counter.picture_baselines.vision_language import first_integer

pytest.importorskip("transformers", reason="needs the extra models")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    from kits.tiny_models import save_clip, save_llava, save_sam2

    return {name: save(tmp_path_factory.mktemp(name)) for name, save in (
        ("sam2", save_sam2), ("clip", save_clip), ("llava", save_llava))}


@pytest.fixture
def picture():
    color = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    return Picture("a", color, "nut", np.zeros((0, 4)))


def test_a_model_is_asked_for_one_number(folders, picture):
    model = load_baseline("vlm", [folders["llava"]])
    answer = model.ask(picture)
    number = first_integer(answer)
    assert answer == model.ask(picture)  # nothing is drawn
    assert model.guess(picture) == ([] if number is None else [number])


def test_the_answer_does_not_begin_with_the_question(folders, picture):
    """The question holds no number that could be taken for one."""
    model = load_baseline("vlm", [folders["llava"]])
    assert "USER" not in model.ask(picture).split()[:1]


def test_a_model_without_a_chat_template_is_refused(folders, tmp_path):
    for path in folders["llava"].iterdir():
        if "chat_template" not in path.name:
            (tmp_path / path.name).write_bytes(path.read_bytes())
    with pytest.raises(WeightsError, match="no chat template"):
        load_baseline("vlm", [tmp_path])


def test_other_models_are_refused(folders, tmp_path):
    with pytest.raises(WeightsError, match="cannot be loaded as an image-text model"):
        load_baseline("vlm", [folders["sam2"]])
    with pytest.raises(WeightsError, match="'clip'; expected 'sam2'"):
        load_baseline("sam_clip", [folders["clip"], folders["clip"]])
    with pytest.raises(WeightsError, match="'sam2_video'; expected 'clip'"):
        load_baseline("sam_clip", [folders["sam2"], folders["sam2"]])
    with pytest.raises(WeightsError, match="no folder"):
        load_baseline("vlm", [tmp_path / "none"])


def test_masks_are_counted_that_look_like_the_part(folders, picture, monkeypatch):
    monkeypatch.setattr(sam_clip, "SETTINGS", replace(
        sam_clip.SETTINGS, points_per_side=4, crops_at_once=2))
    baseline = load_baseline("sam_clip", [folders["sam2"], folders["clip"]])
    assert baseline.guess(picture) == [0]  # a random model is sure of nothing
    masks = [np.zeros((40, 60), bool) for _ in range(5)]
    for i, mask in enumerate(masks):
        mask[5:20, 10 * i:10 * i + 8] = True
    kept = baseline.look_like(picture, masks)
    assert kept.shape == (5,) and kept.dtype == bool
    # With no text against it everything looks like the part.
    monkeypatch.setattr(sam_clip, "SETTINGS", replace(sam_clip.SETTINGS, negative=()))
    assert baseline.look_like(picture, masks).all()


class PlantedSam:
    """Finds a disc of 5.3 pixels around the nearest of some places in a square of 64."""

    def __init__(self, places):
        self.places = np.array(places, float)

    def get_image_embeddings(self, pixels):
        assert pixels.shape == (1, 3, 64, 64)
        return []

    def __call__(self, image_embeddings, input_points, input_labels):
        points = input_points[0, :, 0].numpy()
        nearest = np.linalg.norm(points[:, None] - self.places, axis=-1).argmin(1)
        y, x = np.mgrid[:64, :64]
        odds = np.stack([200 * (5.3 - np.hypot(x - px, y - py))
                         for px, py in self.places[nearest]])
        odds = np.stack([odds, np.full_like(odds, 9.0), odds], 1)  # the second takes all
        quality = np.tile([0.95, 0.99, 0.5], (len(points), 1))  # of the third it is not sure
        return SimpleNamespace(pred_masks=torch.tensor(odds)[None],
                               iou_scores=torch.tensor(quality)[None])


def test_each_thing_is_found_once_where_it_is_in_the_picture(folders, monkeypatch):
    monkeypatch.setattr(sam_clip, "SETTINGS", replace(sam_clip.SETTINGS, points_per_side=8))
    baseline = load_baseline("sam_clip", [folders["sam2"], folders["clip"]])
    # A picture of 96 x 128 is halved, and lies 8 pixels down in the square.
    places = [(10, 20), (30, 40), (54, 30)]
    baseline._sam = PlantedSam(places)
    masks = baseline.find_masks(np.zeros((96, 128, 3), np.uint8))
    middles = sorted(tuple(np.argwhere(m).mean(0)[::-1]) for m in masks)
    np.testing.assert_allclose(middles, [(20.5, 24.5), (60.5, 64.5), (108.5, 44.5)], atol=0.6)
    assert [int(m.sum()) for m in masks] == pytest.approx([4 * np.pi * 5.3**2] * 3, rel=0.1)
