# SPDX-License-Identifier: Apache-2.0
"""Recordings as users have them: each is read as the plain one is, or refused so that it helps.

A line that refuses says what was seen, what is expected, and the setting or command that helps.
"""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from kits import users_recordings as users
from kits.depth_camera import OTHER_SIZE, OWN_DEPTH, SAME_SIZE, own_depth_records, own_depth_scan
from kits.recording_kit import COLOR, DEPTH, INFO, header, image, records, scan, write
from kits.row_of_bins import HALF, RowOfBins

from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.replay import measure_bag
from stack_counter.bag.writer import write_bag
from stack_counter.config import CollectorConfig, Config, ReconstructorConfig
from stack_counter.errors import StackCounterError

DEFAULT = CollectorConfig()


def changed(topic, **fields):
    """What makes a recording in which the messages on a topic have other fields."""
    return lambda path: write(path, [
        (stamp, name, kind, replace(message, **fields) if name == topic else message)
        for stamp, name, kind, message in records(scan())])


FORMS = {f"recorded as {name}": lambda path, name=name: users.in_form(path, name)
         for name in ("sqlite3", "mcap by file", "mcap by message")}
ENCODED = {f"colour as {name}": lambda path, name=name: users.with_color(
    path, name, users.COLORS[name]) for name in users.COLORS}
# By name: what makes the recording, and the settings that it is read with.
READ = {
    **{name: (make, DEFAULT) for name, make in {**FORMS, **ENCODED}.items()},
    "depth by compressedDepth": (users.compressed_depth, DEFAULT),
    "depth by PNG": (users.png_depth, DEFAULT),
    "depth as 32FC1 in mm": (users.float_millimetres, replace(DEFAULT, depth_scale=0.001)),
    "depth as 16UC1 in 0.1 mm": (users.tenth_millimetres, replace(DEFAULT, depth_scale=0.0001)),
    "depth as 16SC1": (users.signed_millimetres, DEFAULT),
    "depth as 64FC1": (users.double_metres, DEFAULT),
    "images whose calibration alone names a frame": (
        lambda path: users.without_frame(path, COLOR, DEPTH), DEFAULT),
    "a calibration of rectified images alone": (changed(INFO, k=np.zeros(9)), DEFAULT),
    "depth in the frame of colour": (lambda path: users.renamed(path, {DEPTH: (
        "/camera/depth/image_raw")}), DEFAULT),
    "rectified colour": (lambda path: users.renamed(path, {
        COLOR: "/camera/color/image_rect_color"}, d=np.array([-0.3, 0.1, 0, 0, 0])), DEFAULT),
    "a lens without coefficients, by any name": (
        changed(INFO, distortion_model="Pinhole"), DEFAULT),
    "steps that nobody has set": (changed(DEPTH, step=0), DEFAULT),
    "depth that says big-endian and is not": (changed(DEPTH, is_bigendian=1), DEFAULT),
    "one raw image beside all compressed ones": (users.with_few_raw_images, DEFAULT),
    "topics of another wrapper": (lambda path: users.under(path, "/camera"), DEFAULT),
    "a root called world": (lambda path: users.of_world(path, "world"),
                            replace(DEFAULT, world_frame="world")),
}


@pytest.mark.parametrize("name", READ)
def test_what_is_recorded_otherwise_is_the_same_scan(tmp_path, name):
    make, settings = READ[name]
    bag = BagViews(make(tmp_path / "bag"), settings)
    views = [view for _, view in bag]
    assert len(views) == 6, bag.hints
    for view, truth in zip(views, scan()):
        assert np.abs(view.depth - truth.depth).max() < 6e-4
        assert np.allclose(view.T_world_camera, truth.T_world_camera, atol=1e-6)
        assert np.array_equal(view.intrinsics.K, truth.intrinsics.K)
        error = np.abs(view.color.mean(-1) - truth.color.mean(-1)).mean()
        assert error < (35 if "bayer" in name else 22)  # neighbours differ by 90 in the mean


@pytest.mark.parametrize("keys, share", [
    ({"depth_file_path": "depths/{}.png"}, 1), ({"suffix": ""}, 1), ({"suffix": ".jpg"}, 1),
    ({"mask_path": "masks/{}.png"}, 2 / 3)], ids=str)
def test_a_folder_of_pictures_is_the_same_scan(tmp_path, keys, share):
    import_scene(users.folder(tmp_path / "scene", **keys), tmp_path / "bag")
    views = [view for _, view in BagViews(tmp_path / "bag", DEFAULT)]
    assert len(views) == 6
    for view, truth in zip(views, scan()):
        seen = view.depth > 0
        assert seen.mean() == pytest.approx(share, abs=0.01) and view.labels is None
        assert np.abs(view.depth - truth.depth)[seen].max() < 6e-4
        assert np.allclose(view.T_world_camera, truth.T_world_camera, atol=1e-6)


@pytest.mark.parametrize("camera", [SAME_SIZE, OTHER_SIZE], ids=["same size", "other size"])
@pytest.mark.parametrize("unnamed", [(), (COLOR, OWN_DEPTH)], ids=["", "images of no frame"])
def test_depth_of_a_camera_of_its_own_is_that_of_the_colour_camera(tmp_path, camera, unnamed):
    path = write(tmp_path / "bag", [
        (stamp, topic, kind, replace(message, header=replace(message.header, frame_id=""))
         if topic in unnamed else message)
        for stamp, topic, kind, message in own_depth_records(camera)])
    views = [view for _, view in BagViews(path, replace(DEFAULT, depth_topic=OWN_DEPTH))]
    truth, _ = own_depth_scan(camera)
    assert len(views) == len(truth)
    for view, true in zip(views, truth):
        seen = view.depth > 0
        assert seen.mean() > 0.8
        assert np.median(np.abs(view.depth - true.depth)[seen]) < 0.001


# --- refused ----------------------------------------------------------------------------------

def refusal(path, collector=DEFAULT, reconstructor=None):
    """The line that says why a recording gives no volume."""
    with pytest.raises(StackCounterError) as caught:
        measure_bag(path, Config(collector=collector,
                                 reconstructor=reconstructor or ReconstructorConfig()), 6e-6)
    return str(caught.value)


def without(*topics):
    """What makes a recording that lacks topics."""
    return lambda path: write(path, [r for r in records(scan()) if r[1] not in topics])


def of_two_cameras(path):
    """Two cameras, neither of the default names."""
    return write(path, [(stamp, topic.replace("/camera/", f"/{name}/"), kind, message)
                        for name in "ab" for stamp, topic, kind, message in records(scan())])


def in_millimetres(path):
    """The robot gives positions in millimetres."""
    views = [replace(v, T_world_camera=v.T_world_camera.copy()) for v in scan()]
    for view in views:
        view.T_world_camera[:3, 3] *= 1000
    return write(path, records(views))


# By name: what makes the recording; what is seen; what is expected; what helps.
REFUSED = {
    "depth as 32FC1 in mm": (users.float_millimetres, "beyond 6.., taken as metres",
                             "expected some metres", "set depth_scale: 0.001"),
    "depth as 16UC1 in 0.1 mm": (users.tenth_millimetres, "half of it is beyond 6.* m",
                                 "expected some", "set depth_scale .*0.0001"),
    "a root called world": (lambda path: users.of_world(path, "world"),
                            "no transforms connect 'base_link'", "expected a chain",
                            "set world_frame to 'world'"),
    "no poses": (without("/tf"), "no transform names 'camera_color", "expected a chain",
                 "record /tf and /tf_static"),
    "poses in mm": (in_millimetres, r"show things \d+ m apart", "expected below 50 m",
                    "poses in metres"),
    "one of two is short": (lambda path: users.two_views_apart(path, 0),
                            r"disagree by \d+ mm.*view 1 of", "expected below 25%", "depth_scale"),
    "the other is short": (lambda path: users.two_views_apart(path, 1),
                           r"disagree by \d+ mm.*view 2 of", "expected below 25%", "depth_scale"),
    "no calibration": (without(INFO), "no message on /camera/color/camera_info",
                       "expected a calibration", "set camera_info_topic"),
    "no colour": (without(COLOR), "no images on /camera/color/image_raw.*the bag has /camera",
                  "expected colour images", "set color_topic"),
    "no depth": (without(DEPTH), f"no depth on {DEPTH}", "expected depth aligned", "record it"),
    "two cameras": (of_two_cameras, "2 cameras in the bag", "expected one",
                    r"set for the collector \{color_topic: /a/.* or \{color_topic: /b/"),
    "colour that is coded": (changed(COLOR, encoding="h264"), "colour in 'h264'",
                             "expected one of .*'rgb8'", "set color_topic, or the driver"),
    "depth that is none": (changed(DEPTH, encoding="rgb8"), "depth in 'rgb8'", "expected 16UC1",
                           "set depth_topic, or the driver"),
    "depth of nothing": (lambda path: users.with_depth(
        path, lambda mm, stamp: image(0 * mm, "16UC1", stamp)), "19200 depth pixels, all invalid",
        "expected some", "check the camera's range"),
    "depth of another size": (lambda path: users.with_depth(
        path, lambda mm, stamp: image(mm[::2, ::2], "16UC1", stamp)), "depth of 80x60",
        "expected 160x120", "set depth_topic"),
    "depth of another time": (changed(DEPTH, header=header(0)), "depth for colour at .*: none",
                              "expected within 5.0 ms", "sync_tolerance_s"),
    "images of no frame": (lambda path: users.without_frame(path, COLOR, INFO),
                           "neither images nor calibration name a frame", "expected a chain",
                           "set their frame_id"),
    "an empty calibration": (changed(INFO, k=np.zeros(9), p=np.zeros(12)), "fx 0.0, fy 0.0",
                             "expected finite numbers", "calibrate"),
    "a calibration of P and distortion": (
        changed(INFO, k=np.zeros(9), d=np.array([0.2, -0.1, 0, 0, 0])), "fx 0.0, fy 0.0",
        "expected finite numbers", "calibrate"),
    "a lens of no model": (changed(INFO, distortion_model="fov", d=np.array([0.9])),
                           r"distortion model 'fov' with coefficients \[0.9\]",
                           "expected one of", "calibrate"),
    "depth of 8 bits": (users.jpeg_depth, "jpeg compressed ' of uint8", "one channel of 16 bits",
                        "record it raw, as PNG"),
    "colour as video": (users.video, "9 bytes of 'h264' do not decode", "expected a JPEG",
                        "no video"),
    "depth as a cloud of points": (users.cloud, f"no depth on {DEPTH}", "expected depth aligned",
                                   r"record images of depth, no /points \(sensor_msgs/msg/Poi"),
    "poses by a topic": (lambda path: users.with_poses(path, "/arm/pose"),
                         "poses on /arm/pose, no /tf", "expected a chain",
                         "set pose_source: topic and pose_topic: /arm/pose"),
    "poses by odometry": (lambda path: users.with_poses(path, "/odom", odometry=True),
                          r"no /tf, and /odom \(Odometry\)", "expected poses as /tf or PoseSt",
                          "publish the camera's pose so"),
    "stamps that nobody has set": (
        lambda path: changed(COLOR, header=header(0))(path), "a second image with stamp 0 ns",
        "expected stamps that grow", "have the driver set header.stamp"),
    "a static transform on /tf": (users.static_on_tf, "'camera.*' in 'tool0' has .* before and no",
                                  "expected samples", "what never changes on /tf_static"),
    "two parents in turn": (users.two_parents, "'camera.*' has", "expected samples",
                            r"also published below \['.*'\]; let it have one parent"),
    "a world whose z is not up": (users.upside_down, "tilted by 180 degrees", "expected z of",
                                  "set world_frame to a frame"),
    "the calibration of another size": (changed(INFO, width=640, height=480), "image of 160x120",
                                        "expected 640x480", "set camera_info_topic"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_says_what_was_seen_what_is_expected_and_what_helps(tmp_path, name):
    make, *parts = REFUSED[name]
    line = refusal(make(tmp_path / "bag"), reconstructor=ReconstructorConfig(min_views=2))
    assert "\n" not in line
    for part in parts:
        assert re.search(part, line), line


def edited(change):
    """What makes a folder whose transforms.json has other keys, or lacks some (None)."""
    def make(path):
        file = users.folder(path) / "transforms.json"
        document = {**json.loads(file.read_text()), **change}
        file.write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    return make


# The same of folders of pictures.
REFUSED_FOLDERS = {
    "no transforms.json": (lambda path: path.mkdir(), "no transforms.json in", "expected a nerf",
                           "--reference"),
    "a folder of TUM RGB-D": (lambda path: (path / "groundtruth.txt").mkdir(parents=True),
                              r"no transforms.json in .*, which looks like TUM RGB-D's \(ground",
                              "expected a nerf", "write its poses so"),
    "no frames": (edited({"frames": []}), "none of the 0 pictures", "expected some", "file_path"),
    "depth that is not there": (
        lambda path: users.folder(path, depth_file_path="deep/{}.png"),
        "none of the 6 pictures .*[(]6 depth images missing", "expected some",
        "mend .*depth_file_path"),
    "pictures that are not there": (
        lambda path: shutil.rmtree(users.folder(path) / "images"),
        "none of the 6 pictures .*[(]6 pictures missing", "expected some, as images/frame_00000",
        "mend file_path"),
    "no calibration": (edited({"fl_x": None}), "images/frame_00000.png lacks fl_x",
                       "expected it", "camera_angle_x"),
    "no lens": (edited({"camera_model": "EQUIRECTANGULAR"}), "camera_model is 'EQUIREC",
                "expected one of .*PINHOLE", "cut perspective pictures"),
}


@pytest.mark.parametrize("name", REFUSED_FOLDERS)
def test_a_folder_is_refused_by_what_was_seen_what_is_expected_and_what_helps(tmp_path, name):
    make, *parts = REFUSED_FOLDERS[name]
    make(tmp_path / "scene")
    with pytest.raises(StackCounterError) as caught:
        import_scene(tmp_path / "scene", tmp_path / "out")
    line = str(caught.value)
    assert "\n" not in line
    for part in parts:
        assert re.search(part, line), line


# --- bins in a rack ---------------------------------------------------------------------------

@pytest.fixture(scope="module")
def rack(tmp_path_factory):
    """Four bins 2 mm apart, of which the first and the third are full; and their recording."""
    row, path = RowOfBins(), tmp_path_factory.mktemp("rack") / "bag"
    write_bag(path, row.views(camera=HALF))
    return row, path


def measured(path, **settings):
    return measure_bag(path, Config(reconstructor=ReconstructorConfig(**settings)), 6e-6)


def test_one_bin_of_a_rack_is_measured_and_without_a_region_all_are_named(rack, tmp_path):
    row, path = rack
    write_bag(tmp_path / "one", RowOfBins((True,)).views(camera=HALF))
    alone = measured(tmp_path / "one").stack_volume
    for place, full in zip(row.regions().values(), (True, False, True, False)):
        found = measured(path, roi_center_m=place["center_m"], roi_size_m=place["size_m"])
        assert found.container.kind == "box" and max(found.container.inner_size_m[:2]) < 0.19
        assert found.stack_volume == pytest.approx(alone if full else 0.0, rel=0.06, abs=2e-5)
    line = refusal(path)
    for part in ("4 containers", "expected one, or a region", "roi_center_m.*roi_size_m"):
        assert re.search(part, line), line


def test_a_bin_on_a_board_is_measured_as_one_on_the_table(tmp_path):
    for name, lift in (("table", 0.0), ("board", 0.028)):
        write_bag(tmp_path / name, RowOfBins((True,), lift=lift).views(camera=HALF))
    table, board = (measured(tmp_path / name) for name in ("table", "board"))
    assert board.stack_volume == pytest.approx(table.stack_volume, rel=0.02)
