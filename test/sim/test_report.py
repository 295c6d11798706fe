# SPDX-License-Identifier: Apache-2.0
"""The page about a folder of scenes."""

from collections import Counter

import numpy as np
import pytest

from stack_counter.sim.report import PAGE, write_report
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.shards import shard_path, write_shard
from stack_counter.sim.shapes import make_shape


def block_scene(index, count):
    """A bin with a pile of blocks, one above the other."""
    block = make_shape(3, "block")
    box = ContainerShape("bin", np.eye(4), (0.12, 0.1, 0.08), 0.003, 0.003)
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (count, 1))
    poses[:, 2] = 0.003 + np.ptp(block.vertices[:, 2]) * (np.arange(count) + 0.5)
    return Scene(1, index, block, box, poses)


def test_page_states_what_the_folder_holds(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'sim' is not installed")
    write_shard(shard_path(tmp_path, 0), [block_scene(0, 2), block_scene(1, 3)],
                Counter({"penetration": 4}))
    (tmp_path / "simulate.log").write_text(
        '{"shard": 0, "scenes": 2, "parts": 5, "seconds": 3.6, "worker": 7}\n{"shard": 1, "sc')
    page = write_report(tmp_path)
    text = page.read_text()
    assert page == tmp_path / PAGE
    for row in ("<th>Scenes</th><td>2 in 1 shards<", "<th>Distinct parts</th><td>1<",
                "<th>Parts in total</th><td>5<", "4 (200.0% of the scenes): penetration 4<",
                "2,000 scenes/h", "bin 100.0%"):
        assert row in text
    assert text.count("data:image/png;base64,iVBOR") == 5 + 2, "five plots, and each scene"
    assert "src='http" not in text, "the page works offline"
    assert write_report(tmp_path, tmp_path / "other.html").read_text() == text


def test_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(SceneError, match="no shard"):
        write_report(tmp_path)
