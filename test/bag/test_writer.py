# SPDX-License-Identifier: Apache-2.0
"""What is written, rosbags reads; and what rosbags writes, the reader reads."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from kits.analytic import Scene
from kits.recording_kit import (
    COLOR,
    DEPTH,
    FRAME,
    INFO,
    LABELS,
    SMALL,
    STORE,
    records,
    scan,
    texture,
    write,
)
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from stack_counter import geometry
from stack_counter.bag.bag_views import read_views, with_scale_of_bag
from stack_counter.bag.camera_topics import fit_camera_to_bag, fit_rig_to_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.writer import write_bag
from stack_counter.config import CollectorConfig, Config, ReconstructorConfig
from stack_counter.errors import BagError
from stack_counter.types import Intrinsics
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

DISTORTED = replace(SMALL, distortion_model="plumb_bob", distortion=(0.1, -0.2, 0.01, 0.02, 0.3))


def views_of(path, **settings):
    """Views that the reader finds in a bag; none may be skipped."""
    reader = BagReader(path)
    rig = fit_rig_to_bag(load_rig(CollectorConfig(**settings)), reader.topics)
    assembler = RigAssembler(rig, live=False)
    views = [view for _, view in read_views(reader, assembler)]
    assert not assembler.tally.skipped
    return views


def by_rosbags(path):
    """Messages by topic, decoded by rosbags."""
    found = {}
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            message = STORE.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def labelled():
    return [replace(v, intrinsics=DISTORTED, labels=(v.depth > 0.45).astype(np.uint8) * 2)
            for v in scan()]


def test_rosbags_reads_what_is_written(tmp_path):
    views = labelled()
    assert write_bag(tmp_path / "bag", views) == 6
    found = by_rosbags(tmp_path / "bag")
    assert {topic: len(m) for topic, m in found.items()} == {
        f"{COLOR}/compressed": 6, DEPTH: 6, LABELS: 6, INFO: 6, "/tf": 18}
    info, depth, labels = found[INFO][2], found[DEPTH][2], found[LABELS][2]
    assert (info.distortion_model, tuple(info.d)) == ("plumb_bob", DISTORTED.distortion)
    np.testing.assert_array_equal(info.k.reshape(3, 3), DISTORTED.K)
    assert (depth.encoding, labels.encoding) == ("16UC1", "mono8")
    seen = depth.data.view(np.uint16).reshape(120, 160)
    np.testing.assert_allclose(seen, views[2].depth * 1000, atol=0.51)
    np.testing.assert_array_equal(labels.data.reshape(120, 160), views[2].labels)
    jpeg = cv2.imdecode(found[f"{COLOR}/compressed"][2].data, cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(jpeg.astype(int) - views[2].color).mean() < 25  # noise; red for blue gives 85
    middle = found["/tf"][7].transforms[0]
    assert (middle.header.frame_id, middle.child_frame_id) == ("base_link", FRAME)
    assert middle.transform.translation.z == views[2].T_world_camera[2, 3]


@pytest.mark.parametrize("compressed", [True, False])
def test_views_come_back(tmp_path, compressed):
    views = labelled()
    write_bag(tmp_path / "bag", views, compressed=compressed)
    back = views_of(tmp_path / "bag")
    assert [v.stamp_ns for v in back] == [v.stamp_ns for v in views]
    for a, b in zip(views, back):
        assert b.intrinsics == DISTORTED and b.camera == FRAME
        np.testing.assert_allclose(b.T_world_camera, a.T_world_camera, atol=1e-9)
        np.testing.assert_allclose(b.depth, a.depth, atol=0.00051)
        np.testing.assert_array_equal(b.labels, a.labels)
        if not compressed:
            np.testing.assert_array_equal(b.color, a.color)


def test_the_reader_reads_what_rosbags_writes(tmp_path):
    views = scan()
    back = views_of(write(tmp_path / "bag", records(views)))
    assert len(back) == 6
    np.testing.assert_array_equal(back[3].color, views[3].color)
    np.testing.assert_allclose(back[3].T_world_camera, views[3].T_world_camera, atol=1e-9)


def test_transforms_of_ones_own_moving_and_static(tmp_path):
    """A camera on a moving hand: the views' poses follow from the samples, not from the views."""
    views, hand_eye = scan(), geometry.pose(np.eye(3), np.array([0.01, 0.02, 0.03]))
    moving = [(v.stamp_ns + d, "base_link", "hand",
               v.T_world_camera @ geometry.inverse(hand_eye))
              for v in views for d in (-30_000_000, 30_000_000)]
    write_bag(tmp_path / "bag", views, moving, static=[(0, "hand", FRAME, hand_eye)])
    for a, b in zip(views, views_of(tmp_path / "bag")):
        np.testing.assert_allclose(b.T_world_camera, a.T_world_camera, atol=1e-9)
        assert not b.fixed
    with Reader(tmp_path / "bag") as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert offered["/tf_static"][0].durability == QosDurability.TRANSIENT_LOCAL


def test_a_fixed_camera(tmp_path):
    views = [replace(v, T_world_camera=scan()[0].T_world_camera) for v in scan()]
    write_bag(tmp_path / "bag", views, [], static=[(0, "base_link", FRAME,
                                                   views[0].T_world_camera)])
    back = views_of(tmp_path / "bag")
    assert len(back) == 6 and all(v.fixed for v in back)


def test_depth_camera_recordings_stay_small(tmp_path):
    """12 noisy RGB-D views of 640x480 within the 8 MB that the repository allows a bag."""
    camera = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5)
    scene = Scene().bin((0.18, 0.14, 0.10), 0.004, 0.004, 0.06)
    view = replace(scene.view(scan()[0].T_world_camera, camera, noise=0.001), camera=FRAME,
                   color=cv2.GaussianBlur(texture(camera), (0, 0), 1.5))
    write_bag(tmp_path / "bag", [replace(view, stamp_ns=(i + 1) * 10**9) for i in range(12)])
    size = sum(path.stat().st_size for path in (tmp_path / "bag").iterdir())
    assert size < 8_000_000, size


def test_metadata_of_the_folder(tmp_path):
    write_bag(tmp_path / "bag", scan())
    told = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"]
    assert (told["storage_identifier"], told["compression_mode"]) == ("mcap", "")
    assert told["relative_file_paths"] == ["bag.mcap"] and told["message_count"] == 36
    assert told["starting_time"]["nanoseconds_since_epoch"] == 10**9 - 20_000_000


def test_nothing_is_overwritten(tmp_path):
    with pytest.raises(BagError, match="exists; expected a new path"):
        write_bag(tmp_path, scan())


def broken(path, text):
    (path / "metadata.yaml").write_text(text)
    return path


def test_folders_that_are_no_whole_bag(tmp_path):
    with pytest.raises(FileNotFoundError, match="expected a rosbag2 folder or an .mcap"):
        BagReader(tmp_path / "nothing")
    with pytest.raises(BagError, match="no .mcap file .* it holds"):
        BagReader(tmp_path)
    path = tmp_path / "bag"
    write_bag(path, scan())
    told = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    for key, value, message in (
            ("relative_file_paths", ["bag.mcap", "bag_1.mcap"],
             "lacks bag_1.mcap, named in its metadata.yaml"),
            ("compression_format", "lz4", "compressed by 'lz4'; expected none or zstd")):
        with pytest.raises(BagError, match=message):
            BagReader(broken(path, yaml.safe_dump(
                {"rosbag2_bagfile_information": {**told, key: value}})))
    for text in ("[", "", "a: 1"):
        with pytest.raises(BagError, match="not a rosbag2 metadata file"):
            BagReader(broken(path, text))
    (path / "metadata.yaml").unlink()  # the recorder was killed
    assert len(views_of(path)) == 6
    assert len(views_of(path / "bag.mcap")) == 6


def test_topics_that_the_bag_lacks(tmp_path):
    views = [replace(v, color=None) for v in scan()]
    write_bag(tmp_path / "bag", views)
    with pytest.raises(BagError) as caught:
        fit_camera_to_bag(CollectorConfig(), BagReader(tmp_path / "bag").topics)
    assert COLOR in str(caught.value) and DEPTH in str(caught.value)
    no_depth = [replace(v, depth=None, labels=np.zeros((120, 160), np.uint8)) for v in scan()]
    write_bag(tmp_path / "labels", no_depth)
    fitted = fit_camera_to_bag(CollectorConfig(), BagReader(tmp_path / "labels").topics)
    assert (fitted.depth_topic, fitted.labels_topic, fitted.color_transport) \
        == ("", LABELS, "compressed")


def test_the_scale_of_the_poses_is_read_back_and_checked(tmp_path):
    write_bag(tmp_path / "sure", scan())
    write_bag(tmp_path / "unsure", scan(), scale_std=0.01)
    write_bag(tmp_path / "wrong", scan(), scale_std=float("nan"))
    config = Config(reconstructor=ReconstructorConfig(scale_std=0.004))

    def scale_std(name):
        return with_scale_of_bag(config, BagReader(tmp_path / name)).reconstructor.scale_std

    assert scale_std("sure") == 0.004 and scale_std("unsure") == 0.01
    with pytest.raises(BagError, match="/camera/scale_std is nan; expected 0 to 0.3"):
        scale_std("wrong")
