# SPDX-License-Identifier: Apache-2.0
"""Rig files: what they may say, and that several assemblers act as one."""

from pathlib import Path

import numpy as np
import pytest

from stack_counter.config import CollectorConfig
from stack_counter.errors import ConfigError
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

ROOT = Path(__file__).parents[2]


def rig(path, **settings):
    return load_rig(CollectorConfig(rig=str(path), **settings))


def test_the_example_is_one():
    of = rig(ROOT / "config" / "rig_example.yaml")
    left, right = of.cameras
    assert (left.name, left.frame, left.T_world_camera) == ("left", "left_optical_frame", None)
    assert right.T_world_camera[:3, 3].tolist() == [0.21557, -0.020219, 0.4197]
    assert np.allclose(right.T_world_camera[:3, :3] @ right.T_world_camera[:3, :3].T, np.eye(3))
    assert (of.tolerance_s, of.timeout_s) == (0.05, 0.5)
    assert RigAssembler(of).needs_tf
    assert RigAssembler(of).color_topics() == ["/left/color/image_raw/compressed",
                                               "/right/color/image_raw/compressed"]


def test_without_a_file_there_is_one_camera_as_configured():
    one = load_rig(CollectorConfig(color_topic="/c", depth_topic=""))
    assert [c.name for c in one.cameras] == [""]
    assert list(RigAssembler(one).topic_handlers()) == ["/c", "/camera/color/camera_info"]


def test_a_depth_camera_of_its_own_is_placed_by_static_transforms(tmp_path):
    """Poses of the rig file need no TF, depth that is not aligned does."""
    pose = "{xyz_m: [0, 0, 1], quaternion_xyzw: [0, 0, 0, 1]}"
    text = "cameras: {a: {color_topic: /a/image, camera_info_topic: /a/info, pose: %s%s}}"
    path = tmp_path / "rig.yaml"
    path.write_text(text % (pose, ""))
    assert RigAssembler(rig(path)).tf_topics() == []
    path.write_text(text % (pose, ", depth_topic: /a/depth/image"))
    both = RigAssembler(rig(path))
    assert both.tf_topics() == ["/tf_static"] and not both.needs_tf
    assert list(both.topic_handlers()) == ["/a/image", "/a/info", "/a/depth/image",
                                           "/a/depth/camera_info"]
    path.write_text(text % (pose, ", depth_topic: /a/depth/image, depth_camera_info_topic: /k"))
    assert "/k" in RigAssembler(rig(path)).topic_handlers()
    # What the settings say of one camera is not said of those of a rig file.
    path.write_text(text % (pose, ", depth_topic: /a/depth/image"))
    assert "/k" not in RigAssembler(rig(path, depth_camera_info_topic="/k")).topic_handlers()


def test_a_cycle_counts_whether_anything_has_changed_or_not():
    assert load_rig(CollectorConfig(mode="cycle")).cameras[0].config.min_change == 0
    assert load_rig(CollectorConfig()).cameras[0].config.min_change > 0


CAMERA = "{color_topic: /a, camera_info_topic: /i}"


@pytest.mark.parametrize("text, said", [
    ("cameras: [", "is not YAML"),
    ("- a", "lacks cameras"),
    ("cameras: {}", "lacks cameras"),
    ("cameras: {a: {color_topic: /a}}", "expected color_topic and camera_info_topic"),
    ("cameras: {a: {colour: /a}}", "expected some of"),
    (f"cameras: {{a: {CAMERA}, b: {CAMERA}}}", "two cameras on one color_topic"),
    (f"cameras: {{a: {CAMERA}}}\nposes: 1", "unknown \\['poses'\\]"),
    ("cameras: {a: {color_topic: 3, camera_info_topic: /i}}", "color_topic is 3; expected str"),
    ("cameras: {a: {color_topic: /a, camera_info_topic: /i, pose: {xyz_m: [0, 0, 1]}}}",
     "expected xyz_m of three numbers and quaternion_xyzw"),
    ("cameras: {a: {color_topic: /a, camera_info_topic: /i, pose: {xyz_m: [0, 0, 1], "
     "quaternion_xyzw: [1, 1, 1, 1]}}}", "of length 1"),
    (f"cameras: {{a: {CAMERA}}}\ntrigger: {{tolerance_s: -1}}", "tolerance_s is -1"),
    (f"cameras: {{a: {CAMERA}}}\ntrigger: {{when: 1}}", "expected some of"),
])
def test_bad_files_are_named(tmp_path, text, said):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        rig(path)
    assert "\n" not in str(caught.value) and "rig.yaml" in str(caught.value)


def test_a_missing_file_is_named():
    with pytest.raises(ConfigError, match="no rig file /nowhere"):
        rig("/nowhere")
