# SPDX-License-Identifier: Apache-2.0
"""Imported scenes: axes, labels, distortion; and the real one where it is at hand."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from kits.bags import bin_views
from kits.nerfstudio import add_images, make_scene
from rosbags.highlevel import AnyReader

from stack_counter import geometry
from stack_counter.bag.bag_views import read_views
from stack_counter.bag.camera_topics import fit_rig_to_bag
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig, ReconstructorConfig
from stack_counter.errors import BagError, ViewError
from stack_counter.multiview.visual_hull import carve_visual_hull
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import UNSEEN
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

PASTA = Path(__file__).parents[4] / "shared" / "real" / "pasta"


def views_of(path):
    reader = BagReader(path)
    rig = fit_rig_to_bag(load_rig(CollectorConfig()), reader.topics)
    return [view for _, view in read_views(reader, RigAssembler(rig))]


def make_labelled_scene(folder, **changes):
    """Label images of value i for picture i, under the key of masks."""
    scene = make_scene(folder, {"mask_path": "masks/{}.png"}, **changes)
    add_images(scene, "masks", np.zeros((120, 160), np.uint8))
    for i in range(3):
        cv2.imwrite(str(scene / f"masks/f{i}.png"), np.full((120, 160), i, np.uint8))
    return scene


def test_axes_labels_and_distortion_survive(tmp_path):
    said = import_scene(make_labelled_scene(tmp_path / "scene"), tmp_path / "out")
    assert "3 views, 3 with labels" in said
    views = views_of(tmp_path / "out")
    for i, view in enumerate(views):
        expected = geometry.look_at(np.array([0.5 * np.cos(i), 0.5 * np.sin(i), 0.4]), np.zeros(3))
        assert np.allclose(view.T_world_camera, expected, atol=1e-9)
        assert view.labels is not None and (view.labels == i % 3).all()
        assert view.intrinsics.distortion == (0.01, -0.02, 0.001, 0.002, 0.0)
    with AnyReader([tmp_path / "out"]) as reader:  # an independent reader agrees
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/camera/labels"] == counts["/camera/color/camera_info"] == 3


def test_missing_files_skip_their_pictures_and_faults_are_named(tmp_path):
    scene = make_labelled_scene(tmp_path / "scene")
    (scene / "images/f1.png").unlink()
    (scene / "masks/f2.png").unlink()
    said = import_scene(scene, tmp_path / "out")
    assert "1 views" in said and "1 pictures missing, 1 masks missing" in said
    with pytest.raises(BagError, match="exists"):
        import_scene(scene, tmp_path / "out")
    with pytest.raises(BagError, match="camera_model"):
        import_scene(make_scene(tmp_path / "b", camera_model="BLURRY"), tmp_path / "out_b")
    assert not (tmp_path / "out_b").exists()
    with pytest.raises(BagError, match="no transforms.json"):
        import_scene(scene / "transforms.json", tmp_path / "out_c")
    (scene / "transforms.json").write_text("{]")
    with pytest.raises(BagError, match="malformed"):
        import_scene(scene, tmp_path / "out_c")
    (scene / "transforms.json").rename(scene / "transforms_train.json")
    with pytest.raises(BagError, match="rename one of transforms_train.json"):
        import_scene(scene, tmp_path / "out_c")
    (make_scene(tmp_path / "c") / "images").rename(tmp_path / "c/pictures")
    with pytest.raises(BagError, match=r"none .* \(3 pictures missing\); .*, as images/f0.png"):
        import_scene(tmp_path / "c", tmp_path / "out_c")


@pytest.mark.parametrize("suffix", ["", ".jpg", ".JPG"])
def test_pictures_are_found_without_their_suffix_or_with_another(tmp_path, suffix):
    assert "3 views" in import_scene(make_scene(tmp_path / "scene", suffix=suffix),
                                     tmp_path / "out")


@pytest.mark.parametrize("keys", [{"depth_file_path": "depths/{}.png"}, {}])
def test_depth_is_used_and_masked_by_masks(tmp_path, keys):
    scene = make_scene(tmp_path / "scene", {**keys, "mask_path": "masks/{}.png"})
    add_images(scene, "depths", np.full((120, 160), 500, np.uint16))
    mask = np.full((120, 160), 255, np.uint8)
    mask[:40] = 0
    add_images(scene, "masks", mask)
    said = import_scene(scene, tmp_path / "out")
    source = "" if keys else " of depths/, which transforms.json does not name"
    assert f"3 views, 0 with labels, 3 with depth{source}, 3 masked" in said
    for view in views_of(tmp_path / "out"):
        assert view.labels is None and view.depth is not None
        assert not view.depth[:40].any() and np.allclose(view.depth[40:], 0.5)


def test_a_folder_called_depth_that_holds_none_is_named(tmp_path):
    scene = add_images(make_scene(tmp_path / "scene"), "depth", np.zeros((120, 160, 3), np.uint8))
    with pytest.raises(BagError, match="expected one channel .*; rename depth/, which"):
        import_scene(scene, tmp_path / "out")
    keys = {"depth_file_path": "depth/{}.png", "depth_unit_scale_factor": "mm"}
    with pytest.raises(BagError, match="depth_unit_scale_factor is 'mm'; expected metres"):
        import_scene(add_images(make_scene(tmp_path / "b", keys), "depth",
                                np.full((120, 160), 500, np.uint16)), tmp_path / "out")


def test_what_a_mask_leaves_out_has_no_label_and_gets_none_by_prompts(tmp_path):
    mask = np.full((120, 160), 255, np.uint8)
    mask[:40] = 0
    keys = {"mask_path": "masks/{}.png"}
    labelled = add_images(make_scene(tmp_path / "labelled", keys), "masks", mask)
    add_images(labelled, "labels", np.full((120, 160), 2, np.uint8))
    import_scene(labelled, tmp_path / "a")
    for view in views_of(tmp_path / "a"):
        assert (view.labels[:40] == UNSEEN).all() and (view.labels[40:] == 2).all()
    # Without labels, views are refused, unless prompts give some.
    import_scene(add_images(make_scene(tmp_path / "plain", keys), "masks", mask), tmp_path / "b")
    views = views_of(tmp_path / "b")
    with pytest.raises(ViewError, match="expected one of them, or prompts"):
        ScanLabels(ReconstructorConfig()).check_view(views[0])
    (tmp_path / "prompts.json").write_text(
        '{"parts": {"points": [[80, 60]]}, "container": {"points": [[20, 100]]}}')
    labels = ScanLabels(ReconstructorConfig(prompts=str(tmp_path / "prompts.json")))
    labels.check_view(views[0])
    for view in labels.label(views):
        assert (view.labels[:40] == UNSEEN).all() and (view.labels[40:] <= 2).all()


def test_a_mask_is_not_carved_by(tmp_path):
    views = [replace(view, labels=np.zeros((120, 160), np.uint8)) for view in bin_views()]
    for view in views:
        view.labels[30:90, 40:120] = 2
    whole = carve_visual_hull(views, 0.01, 0.5).volume
    views[0].labels[:] = 0  # one view proves nearly all of it empty
    assert carve_visual_hull(views, 0.01, 0.5).volume < 0.01 * whole
    views[0].labels[:] = UNSEEN
    assert carve_visual_hull(views, 0.01, 0.5).volume >= whole


def test_depth_is_found_by_the_keys_of_instant_ngp(tmp_path):
    scene = make_scene(tmp_path / "scene", {"depth_path": "d/{}.png"}, integer_depth_scale=1e-4)
    add_images(scene, "d", np.full((120, 160), 5000, np.uint16))
    assert "3 with depth" in import_scene(scene, tmp_path / "out")
    assert np.allclose(views_of(tmp_path / "out")[0].depth, 0.5)


@pytest.mark.parametrize("key", ["colmap_im_id", "sharpness"])
def test_poses_of_colmap_must_state_their_scale(tmp_path, key):
    keys = {key: 1}
    with pytest.raises(BagError, match=f"COLMAP's .{key}.* expected applied_scale"):
        import_scene(make_scene(tmp_path / "scene", keys), tmp_path / "out")
    said = import_scene(make_scene(tmp_path / "scaled", keys, applied_scale=2.0),
                        tmp_path / "out_scaled")
    assert "positions divided by the scale applied, 2" in said
    assert np.allclose(views_of(tmp_path / "out_scaled")[0].T_world_camera[:3, 3], (0.25, 0, 0.2))
    # What a depth camera measured is checked against the poses later; matched points are not.
    keys = {**keys, "depth_file_path": "d/{}.png"}
    depth = np.full((120, 160), 500, np.uint16)
    import_scene(add_images(make_scene(tmp_path / "dense", keys), "d", depth), tmp_path / "b")
    depth[:, 10:] = 0
    with pytest.raises(BagError, match="COLMAP's"):
        import_scene(add_images(make_scene(tmp_path / "few", keys), "d", depth), tmp_path / "c")


def test_scenes_of_3dc_real_are_read_as_published(tmp_path):
    scene = make_scene(tmp_path / "bolt2", {"colmap_im_id": 1}, suffix=".jpg")
    cutout = np.zeros((120, 160, 4), np.uint8)
    cutout[:, :100, 3] = 255
    add_images(scene, "box_seg", cutout)
    cutout[:, 50:, 3] = 0
    add_images(scene, "obj_seg", cutout)
    (scene / "info.json").write_text('{"gt_count": 82, "unit_volume": 4.93}')
    said = import_scene(scene, tmp_path / "out")
    assert "3 with labels" in said and f"replay {tmp_path / 'out'} --unit-volume-cm3 4.93" in said
    for view in views_of(tmp_path / "out"):
        assert view.labels[0, [0, 49, 50, 99, 100]].tolist() == [2, 2, 1, 1, 0]
    assert json.loads((tmp_path / "out/truth.json").read_text()) == {"count": 82}
    # The list of all parts comes first, by the name without its number; -1 is not known.
    (tmp_path / "unit_volumes.json").write_text('{"note1": "carved", "bolt": 5.5}')
    (scene / "info.json").write_text('{"gt_count": -1, "unit_volume": -1}')
    assert "--unit-volume-cm3 5.5" in import_scene(scene, tmp_path / "out2")
    assert not (tmp_path / "out2/truth.json").exists()
    (scene / "obj_seg/f1.png").unlink()
    assert "2 views" in import_scene(scene, tmp_path / "out3")


@pytest.mark.skipif(not PASTA.is_dir(), reason=f"no real scene at {PASTA}")
def test_real_scene_gives_the_hull_of_the_bag_and_stereo_carves_it(tmp_path):
    from stack_counter.multiview import visual_hull
    from stack_counter.pipeline import StackCounter

    assert "54 views, 54 with labels" in import_scene(PASTA, tmp_path / "pasta")
    views = list(views_of(tmp_path / "pasta"))
    # A visual hull of the outline, no votes to spare, measured independently: 2443 cm3.
    whole = visual_hull.carve_visual_hull(views, 0.003, 0.5).volume
    assert whole == pytest.approx(2443e-6, rel=0.01)
    stack = StackCounter(ReconstructorConfig(voxel_size=0.003))
    for view in views:
        stack.add_view(view)
    volume = stack.volume()
    assert "depth_from_pictures" in volume.reasons
    assert 588 * 1.05476e-6 < volume.stack_volume < whole  # the noodles themselves; the hull
