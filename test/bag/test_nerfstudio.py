# SPDX-License-Identifier: Apache-2.0
"""Imported scenes: axes, labels, distortion; and the real one where it is at hand."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from kits.bags import picture
from rosbags.highlevel import AnyReader

from stack_counter import geometry
from stack_counter.bag.bag_views import read_views
from stack_counter.bag.camera_topics import fit_rig_to_bag
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

PASTA = Path(__file__).parents[3] / "shared" / "real" / "pasta"
FLIP = np.diag([1.0, -1, -1, 1])


def views_of(path):
    reader = BagReader(path)
    rig = fit_rig_to_bag(load_rig(CollectorConfig()), reader.topics)
    return [view for _, view in read_views(reader, RigAssembler(rig))]


def make_scene(folder, **changes):
    (folder / "images").mkdir(parents=True)
    frames = []
    for i in (2, 0, 1):
        optical = geometry.look_at(np.array([0.5 * np.cos(i), 0.5 * np.sin(i), 0.4]), np.zeros(3))
        cv2.imwrite(str(folder / f"images/f{i}.png"), picture(i))
        frames.append({"file_path": f"images/f{i}.png", "mask_path": f"masks/f{i}.png",
                       "transform_matrix": (optical @ FLIP).tolist()})
    (folder / "masks").mkdir()
    for i in range(3):
        cv2.imwrite(str(folder / f"masks/f{i}.png"), np.full((120, 160), i % 3, np.uint8))
    document = {"w": 160, "h": 120, "fl_x": 150.0, "fl_y": 151.0, "cx": 80.0, "cy": 60.0,
                "k1": 0.01, "k2": -0.02, "p1": 0.001, "p2": 0.002, "camera_model": "OPENCV",
                "frames": frames, **changes}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def test_axes_labels_and_distortion_survive(tmp_path):
    said = import_scene(make_scene(tmp_path / "scene"), tmp_path / "out")
    assert "3 views, 3 with labels" in said
    views = views_of(tmp_path / "out")
    assert len(views) == 3
    for i, view in enumerate(views):
        # The world's origin lies on every optical axis, in front of the camera.
        pixel, z = geometry.project(geometry.apply(geometry.inverse(view.T_world_camera),
                                                   np.zeros(3)), view.intrinsics)
        assert pixel == pytest.approx([80, 60], abs=1e-6) and z == pytest.approx(0.41**0.5)
        assert view.labels is not None and (view.labels == i % 3).all()
        assert view.intrinsics.distortion == (0.01, -0.02, 0.001, 0.002, 0.0)
    with AnyReader([tmp_path / "out"]) as reader:  # an independent reader agrees
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/camera/labels"] == counts["/camera/color/camera_info"] == 3


def test_missing_pictures_are_skipped_and_faults_named(tmp_path):
    scene = make_scene(tmp_path / "scene")
    (scene / "images/f1.png").unlink()
    assert "1 pictures missing" in import_scene(scene, tmp_path / "out")
    with pytest.raises(BagError, match="exists"):
        import_scene(scene, tmp_path / "out")
    with pytest.raises(BagError, match="camera_model"):
        import_scene(make_scene(tmp_path / "b", camera_model="BLURRY"), tmp_path / "out_b")
    with pytest.raises(BagError, match="no transforms.json"):
        import_scene(scene / "transforms.json", tmp_path / "out_c")
    (scene / "transforms.json").write_text("{]")
    with pytest.raises(BagError, match="malformed"):
        import_scene(scene, tmp_path / "out_c")


@pytest.mark.skipif(not PASTA.is_dir(), reason=f"no real scene at {PASTA}")
def test_real_scene_gives_the_hull_of_the_bag_and_stereo_carves_it(tmp_path):
    from stack_counter.config import ReconstructorConfig
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
