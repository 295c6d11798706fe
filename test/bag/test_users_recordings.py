# SPDX-License-Identifier: Apache-2.0
"""Recordings as users have them: each is read as the plain one is, or refused so that it helps.

A line that refuses says what was seen, what is expected, and the setting or command that helps.
"""

from dataclasses import replace

import numpy as np
import pytest
from kits import users_recordings as users
from kits.depth_camera import OTHER_SIZE, OWN_DEPTH, SAME_SIZE, own_depth_records, own_depth_scan
from kits.recording_kit import records, scan, write
from kits.row_of_bins import HALF, RowOfBins

from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.replay import measure_bag
from stack_counter.bag.writer import write_bag
from stack_counter.config import CollectorConfig, Config, ReconstructorConfig, build_section
from stack_counter.errors import StackCounterError

DEFAULT = CollectorConfig()
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
        assert error < (35 if "bayer" in name else 20)  # neighbours differ by 90 in the mean


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
def test_depth_of_a_camera_of_its_own_is_that_of_the_colour_camera(tmp_path, camera):
    path = write(tmp_path / "bag", own_depth_records(camera))
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


# By name: what makes the recording; what is seen; what is expected; what helps.
REFUSED = {
    "depth as 32FC1 in mm": (users.float_millimetres, "wrong_depth_unit: /camera/", "expected",
                             "depth_scale: 0.001"),
    "depth as 16UC1 in 0.1 mm": (users.tenth_millimetres, "wrong_depth_unit: /camera/", "expected",
                                 "depth_scale: 0.0001"),
    "a root called world": (lambda path: users.of_world(path, "world"), "base_link", "expected",
                            "world_frame: world"),
    "no poses": (lambda path: write(path, records(scan(), poses=False)), "no_tf", "expected",
                 "/tf"),
    "one of two is short": (lambda path: users.two_views_apart(path, 0), r"disagree by \d+ mm",
                            "expected", "view 1 of"),
    "the other is short": (lambda path: users.two_views_apart(path, 1), r"disagree by \d+ mm",
                           "expected", "view 2 of"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_says_what_was_seen_what_is_expected_and_what_helps(tmp_path, name):
    make, seen, expected, helps = REFUSED[name]
    line = refusal(make(tmp_path / "bag"), reconstructor=ReconstructorConfig(min_views=1))
    assert "\n" not in line
    print(line)
