# SPDX-License-Identifier: Apache-2.0
"""Scans that cannot be right are refused or say so."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.construction import make_container
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.pipeline import StackCounter
from stack_counter.reconstruction.plausibility import rim_leaves_images, stack_leaves_every_image

INNER, FILL = (0.3, 0.2, 0.12), 0.07


def bin_views(scene=None, **how):
    scene = scene or Scene().bin(INNER, 0.005, 0.005, FILL)
    return scene.views(**{"noise": 0.001, **how})


def reconstruct(views, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in views:
        stack.add_view(view)
    return stack.volume()


def test_a_scan_with_shifted_poses_gives_no_count():
    views = bin_views()
    shifted = [replace(v, T_world_camera=w.T_world_camera)
               for v, w in zip(views, views[1:] + views[:1])]
    with pytest.raises(ScanError):
        reconstruct(shifted)


def test_a_hand_in_one_view_is_carved_away():
    views = bin_views()
    hand = Scene().bin(INNER, 0.005, 0.005, FILL).box([0, 0, 0.2], [0.08, 0.08, 0.05])
    views[4] = hand.view(views[4].T_world_camera, stamp_ns=views[4].stamp_ns, noise=0.001, seed=4)
    assert reconstruct(views).stack_volume == pytest.approx(0.3 * 0.2 * FILL, rel=0.03)


@pytest.mark.parametrize("labelled", [True, False])
def test_a_background_label_carves_where_depth_is_missing(labelled):
    """A ghost beside the bin that one view sees; the others have no depth there."""
    clean = bin_views()
    ghosts = Scene().bin(INNER, 0.005, 0.005, FILL).box([0, 0.17, 0.1], [0.05, 0.05, 0.05])
    haunted = [ghosts.view(v.T_world_camera, stamp_ns=v.stamp_ns, noise=0.001, seed=i)
               for i, v in enumerate(clean)]
    views = [haunted[0]]
    for view, other in zip(clean[1:], haunted[1:]):
        hidden = np.abs(view.depth - other.depth) > 0.005
        labels = np.where(hidden, 0, 2).astype(np.uint8) if labelled else None
        views.append(replace(view, depth=np.where(hidden, 0, view.depth), labels=labels))
    vertices = reconstruct(views).mesh.vertices
    there = np.all(np.abs(vertices - [0, 0.17, 0.125]) < [0.02, 0.02, 0.01], axis=1).sum()
    assert (there == 0) == labelled


def test_a_bin_beyond_all_images_is_told():
    views = bin_views(radius=0.25)
    region = Region(np.array([-0.3, -0.3, -0.02]), np.array([0.3, 0.3, 0.2]), 0.0, 0.001)
    assert stack_leaves_every_image(views, region)
    assert not stack_leaves_every_image(bin_views(), region)


def test_more_memory_than_allowed_is_a_reason_to_skip_views():
    stack = StackCounter(ReconstructorConfig(max_memory_mb=10.0, voxel_size=0.001))
    for view in bin_views():
        try:
            stack.add_view(view)
        except Exception as error:
            assert "max_memory_mb" in str(error)
    assert stack.tally.skipped["too_large"] > 0


def test_what_is_taken_away_disappears():
    with_box = Scene().box([0, 0, 0.02], [0.1, 0.1, 0.04]).box([0.1, 0.1, 0.01], [0.1, 0.1, 0.02])
    without = Scene().box([0.1, 0.1, 0.01], [0.1, 0.1, 0.02])
    views = with_box.views(24, noise=0.001) + without.views(12, noise=0.001)
    settings = {"roi_center_m": (0.05, 0.05, 0.05), "roi_size_m": (0.4, 0.4, 0.2)}
    volume = reconstruct(views, max_weight=4.0, **settings).stack_volume
    assert volume == pytest.approx(0.1 * 0.1 * 0.02, rel=0.06)


@pytest.mark.parametrize("beyond, leaves", [(0.0, False), (0.1, True)])
def test_a_rim_beyond_all_images_is_told(beyond, leaves):
    """A camera that looks down on a bin whose one end it does not show."""
    views = [Scene().view(geometry.look_at(np.array([x, 0.001, 0.6]), np.array([x, 0.0, 0.0])))
             for x in (beyond, beyond + 0.01)]
    wall = BoxWall(np.array([0, 0, 0, 0.36, 0.2, 0.0]))
    assert rim_leaves_images(make_container(wall, 0.004, 0.1, 0.004, 0.0), views) == leaves
