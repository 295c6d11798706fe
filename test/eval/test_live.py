# SPDX-License-Identifier: Apache-2.0
"""`evaluate live`: what the gate takes for a duplicate leaves the count as it was."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from kits.single_part import HEAP, one_part

from stack_counter.eval import live
from stack_counter.types import Intrinsics, View

SCENE = one_part(trimesh.creation.box([0.02, 0.02, 0.02]), 0.01, HEAP)
CAMERA = Intrinsics(160, 120, 152.5, 152.5, 79.5, 59.5)


class CountsViews:
    """A `StackCounter` whose count is the number of views it was given."""

    def __init__(self, config, unit_volume):
        self.views = 0

    def add_view(self, view):
        self.views += 1

    def count(self, part, estimator, confidence):
        return SimpleNamespace(count=self.views, count_interval=(self.views, self.views))


@pytest.mark.parametrize("pictures, counts", [((0, 1, 2), [1, 2, 3]), ((0, 0, 1), [1, 1, 2])])
def test_views_pass_the_gate_and_duplicates_change_nothing(monkeypatch, pictures, counts):
    colors = np.random.default_rng(0).integers(0, 255, (3, 120, 160, 3)).astype(np.uint8)
    views = [View(i, CAMERA, np.eye(4), colors[k]) for i, k in enumerate(pictures)]
    monkeypatch.setattr(live, "StackCounter", CountsViews)
    monkeypatch.setattr(live, "make_estimator", lambda config: None)
    monkeypatch.setattr(live, "remove_parts", lambda scene, taken: [scene] * 3)
    monkeypatch.setitem(live._CAMERAS, "tf", lambda states: views)
    assert [c.count for c in live.count_while_picking(SCENE, 2, camera="tf")] == counts
