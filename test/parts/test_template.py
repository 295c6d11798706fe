# SPDX-License-Identifier: Apache-2.0
"""v from pieces that lie apart on a table."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.parts.template import scan_template
from stack_counter.parts.template_model import Template, shipped_template_model
from stack_counter.sim import record
from stack_counter.sim.physics.table import lay_out_pieces, rest_rotations
from stack_counter.sim.shapes import make_shape

BRACKET = make_shape(11, "bracket")


def scan(shape, pieces, told=None, **changes):
    views = record(lay_out_pieces(shape, pieces, 1), 12, 0, color=False)
    return scan_template(views, told or pieces, ReconstructorConfig(**changes))


def test_pieces_lie_apart_and_each_in_a_rest_pose():
    scene = lay_out_pieces(BRACKET, 7, 3)
    turns, chances = rest_rotations(BRACKET)
    assert chances.sum() == pytest.approx(1) and len(scene.poses) == 7
    vertices = scene.parts_mesh().vertices.reshape(7, -1, 3)
    assert np.abs(vertices[..., 2].min(axis=1)).max() < 1e-4, "they stand on the table"
    low, high = vertices[..., :2].min(axis=1), vertices[..., :2].max(axis=1)
    overlap = (np.minimum(high[:, None], high) - np.maximum(low[:, None], low)).min(axis=-1)
    assert overlap[~np.eye(7, dtype=bool)].max() < 0
    assert len(np.unique(vertices[..., 2].max(axis=1).round(4))) >= min(len(turns), 3)


def test_v_of_a_part_in_several_poses():
    template = scan(BRACKET, 6)
    v, std = shipped_template_model().unit_volume(template)
    assert template.carved.shape == (6,) and template.carved.min() > 0.7 * BRACKET.unit_volume
    assert abs(v / BRACKET.unit_volume - 1) < max(3 * std / v, 0.1)
    assert 0.01 < std / v < 0.3


def test_more_pieces_leave_less_unknown():
    features = scan(BRACKET, 3).features
    model = shipped_template_model()
    one, six = (model.unit_volume(Template(np.full(n, 1e-5), features)) for n in (1, 6))
    assert one[0] == six[0] and one[1] >= six[1]


@pytest.mark.parametrize("pieces, told", [(4, 5), (4, 3)])
def test_another_number_of_pieces_is_refused_with_both(pieces, told):
    with pytest.raises(ScanError, match=f"{pieces} pieces lie on the table; expected {told}"):
        scan(BRACKET, pieces, told)


def test_round_parts_are_told():
    ball = make_shape(0, "pebble")
    assert not scan(BRACKET, 5).alike
    assert Template(np.array([1.0, 1.01, 0.99]) * 1e-6, np.zeros(1)).alike and ball.convexity > 0.9


def test_views_without_depth_are_too_few():
    views = [v for v in record(lay_out_pieces(BRACKET, 2, 1), 3, 0, color=False)]
    with pytest.raises(ScanError, match="2 views with depth; expected at least 6"):
        scan_template(views[:2], 2, ReconstructorConfig())


def test_pieces_that_are_not_whole_are_refused():
    scene = lay_out_pieces(BRACKET, 5, 1)
    poses = scene.poses.copy()
    tall = scene.parts_mesh().vertices.reshape(5, -1, 3)[0, :, 2].max()
    poses[0, 2] -= 0.75 * tall  # sunk into the table
    views = record(replace(scene, poses=poses), 12, 0, color=False)
    with pytest.raises(ScanError, match="times the smallest; expected whole pieces"):
        scan_template(views, 5, ReconstructorConfig())
