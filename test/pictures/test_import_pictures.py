# SPDX-License-Identifier: Apache-2.0
"""Rendered pictures without poses become a bag with the right poses, scale, up and error."""

import cv2
import numpy as np
import pytest
from kits.analytic import Scene
from kits.textures import textured_views
from PIL import Image

from stack_counter import geometry
from stack_counter.bag.bag_views import with_scale_of_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replay import read_scan
from stack_counter.config import Config
from stack_counter.errors import BagError
from stack_counter.pictures.import_pictures import _check_distance, import_pictures
from stack_counter.pictures.scale import Scale
from stack_counter.pictures.structure_from_motion import Camera, PosedPictures
from stack_counter.types import CONTAINER, PARTS, Intrinsics

A, B = np.array([-0.15, 0.1, 0.0]), np.array([0.15, -0.1, 0.0])
LARGE, TURNED = 1, 2  # numbers of the pictures that are larger, or stored turned


def mark_text(point, views):
    """Marks of a point in the first three pictures that show it."""
    out = []
    for i, view in enumerate(views):
        (x, y), z = geometry.project(
            geometry.apply(geometry.inverse(view.T_world_camera), point), view.intrinsics)
        size = 1.5 if i == LARGE else 1.0
        if z > 0 and 2 < x < view.intrinsics.width - 2 and 2 < y < view.intrinsics.height - 2:
            out.append(f"p{i}.jpg:{size * (x + 0.5) - 0.5:.2f},{size * (y + 0.5) - 0.5:.2f}")
    return " ".join(out[:3])


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """True views of a textured block, the bag of their bare pictures, and what import says."""
    folder = tmp_path_factory.mktemp("pictures")
    scene = Scene().box([0, 0, 0.03], (0.14, 0.1, 0.06))
    views = textured_views(scene, lambda p: np.where(p[..., 0] > 0.04, CONTAINER, PARTS), count=9)
    (folder / "labels").mkdir()
    for i, view in enumerate(views):
        pixels, labels = view.color, view.labels
        if i == LARGE:
            pixels = cv2.resize(pixels, (480, 360), interpolation=cv2.INTER_CUBIC)
            labels = cv2.resize(labels, (480, 360), interpolation=cv2.INTER_NEAREST)
        exif = Image.Exif()
        if i == TURNED:
            pixels, exif[0x0112] = np.ascontiguousarray(np.rot90(pixels)), 6
        Image.fromarray(pixels).save(folder / f"p{i}.jpg", quality=95, exif=exif)
        Image.fromarray(labels).save(folder / f"labels/p{i}.png")
    out = folder / "bag"
    length = float(np.linalg.norm(B - A))
    text = import_pictures(folder, out, [f"{mark_text(A, views)} to {mark_text(B, views)} = "
                                         f"{length}"])
    return views, out, text


def test_all_register_and_the_lines_say_so(imported):
    _, out, text = imported
    assert text.startswith(f"{out}: 9 views, 9 with labels; 9 of 9 pictures registered\n")
    assert "up: the support plane" in text


def test_poses_have_the_true_scale_and_stand_upright(imported):
    truth, out, _ = imported
    views = read_scan(out, Config())
    assert len(views) == 9
    # One turn about z and a shift along the ground lead from the bag's world to the true one.
    T = truth[0].T_world_camera @ geometry.inverse(views[0].T_world_camera)
    assert T[2, :3] == pytest.approx([0, 0, 1], abs=5e-3) and abs(T[2, 3]) < 2e-3
    for i, (view, true) in enumerate(zip(views, truth)):
        distance, angle = geometry.pose_change(T @ view.T_world_camera, true.T_world_camera)
        assert distance < 4e-3 and angle < 8e-3
        assert view.intrinsics.width == (480 if i == LARGE else 320)
        assert view.intrinsics.fx == pytest.approx(450 if i == LARGE else 300, rel=0.02)
        assert view.labels is not None and view.labels.shape == view.color.shape[:2]
    spread = [np.linalg.norm(np.std([v.T_world_camera[:3, 3] for v in some], axis=0))
              for some in (views, truth)]
    assert spread[0] == pytest.approx(spread[1], rel=0.01)


def test_the_bag_says_how_exact_its_scale_is(imported):
    config = with_scale_of_bag(Config(), BagReader(imported[1]))
    assert 0.001 < config.reconstructor.scale_std < 0.02
    assert f"{config.reconstructor.scale_std:.1%}" in imported[2]


def test_pictures_that_show_nothing_in_common_are_refused(tmp_path):
    random = np.random.default_rng(0)
    for i in range(3):
        noise = cv2.resize(random.integers(0, 255, (40, 53, 3), np.uint8), (212, 160))
        Image.fromarray(noise).save(tmp_path / f"n{i}.png")
    with pytest.raises(BagError, match=r"0 of 3 pictures registered \(0%\); expected 60% .* "
                                       "not registered: n0.png, n1.png, n2.png"):
        import_pictures(tmp_path, tmp_path / "out",
                        ["n0.png:5,5 n1.png:5,5 to n0.png:90,5 n1.png:90,5 = 0.3"])
    assert not (tmp_path / "out").exists()


def test_a_length_in_another_unit_is_noticed():
    seen = {f"p{i}": Camera(Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5),
                            geometry.look_at(np.array([1.0, i, 1]), np.zeros(3)))
            for i in range(3)}
    posed = PosedPictures(seen, np.zeros((5, 3)), [])
    _check_distance(posed, Scale(0.5, 0.01))
    with pytest.raises(BagError, match="taken from 866 m; expected 0.03 to 10 m"):
        _check_distance(posed, Scale(500.0, 0.01))
