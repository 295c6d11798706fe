# SPDX-License-Identifier: Apache-2.0
"""The container catalogue: what it holds, what of it is refused, and that comments stay."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import (
    TaughtContainer,
    configured_container,
    load_containers,
    save_container,
)
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall
from stack_counter.errors import ConfigError
from stack_counter.types import InnerMap

TAUGHT = {
    "box": TaughtContainer(BoxWall(np.array([0, 0, 0, 0.3, 0.2, 0.14])), 0.004, 0.006, 0.12, "a"),
    "round": TaughtContainer(RoundWall(np.array([0, 0, 0.1, 0.05, -1])), 0.003, 0.0, 0.1, "b: #"),
    "free": TaughtContainer(FreeWall(np.linspace(0.1, 0.2, 27), np.zeros(2)), 0.004, 0.003, 0.1),
}


def test_what_is_saved_is_loaded_and_others_stay(tmp_path):
    path = tmp_path / "c.yaml"
    for name in (*TAUGHT, "round"):
        save_container(name, TAUGHT[name], path)
    loaded = load_containers(path)
    assert list(loaded) == ["box", "round", "free"]
    for name, taught in TAUGHT.items():
        assert loaded[name].wall_shape.kind == name
        assert loaded[name].wall_shape.params == pytest.approx(taught.wall_shape.params)
        assert loaded[name].taught == taught.taught
        assert (loaded[name].wall_m, loaded[name].floor_m, loaded[name].rim_m) \
            == (taught.wall_m, taught.floor_m, taught.rim_m)
    assert all(" # " in line for line in path.read_text().splitlines() if line[:4] == "    ")


@pytest.mark.parametrize("old, new, said", [
    ("draft: 0.14", "draft: steep", "could not convert string to float: 'steep'"),
    ("draft: 0.14", "draft: .nan", "draft: nan"), ("draft:", "daft:", "malformed at 'draft'"),
    ("[0.3, 0.2]", "[0.3]", "2 numbers needed"), ("wall_m: 0.004", "wall_m: -1", "0 or more"),
    ("rim_m: 0.12", "rim_m: 0.001", "above floor_m"), ('kind: "box"', "kind: tub", "kind: tub"),
    ("containers:", "containers: [", "malformed")])
def test_a_damaged_catalogue_is_one_line(tmp_path, old, new, said):
    path = tmp_path / "c.yaml"
    save_container("box", TAUGHT["box"], path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ConfigError, match=said):
        load_containers(path)


def test_settings_that_contradict_the_catalogue_are_refused(tmp_path):
    path = str(tmp_path / "c.yaml")
    for name in ("box", "round"):
        save_container(name, TAUGHT[name], tmp_path / "c.yaml")
    with pytest.raises(ConfigError, match=r"unknown container 'tub'; expected .*'box', 'round'"):
        configured_container(ReconstructorConfig(container="tub", container_catalogue=path))
    with pytest.raises(ConfigError, match="container_floor_m is 0.01 beside container 'box'"):
        configured_container(ReconstructorConfig(container="box", container_catalogue=path,
                                                 container_floor_m=0.01))
    with pytest.raises(ConfigError, match="no container catalogue none.yaml"):
        configured_container(ReconstructorConfig(container="box",
                                                 container_catalogue="none.yaml"))


def test_the_comments_and_the_order_of_a_users_file_stay(tmp_path):
    path = tmp_path / "c.yaml"
    save_container("tub", TAUGHT["round"], path)
    save_container("box", TAUGHT["box"], path)
    text = "# Cell 7\n" + path.read_text().replace(
        "draft: 0.14", "draft: 0.14  # by hand").replace('  "box"', "  # The blue ones\n  box")
    path.write_text(text + "# end\n")
    save_container("can", TAUGHT["round"], path)
    assert path.read_text().startswith(text) and path.read_text().endswith("# end\n")
    save_container("tub", TAUGHT["box"], path)
    assert list(load_containers(path)) == ["tub", "box", "can"]
    assert load_containers(path)["tub"].wall_shape.kind == "box"
    kept = path.read_text()
    assert kept[kept.index("  # The blue ones"):].startswith(text[text.index("  # The blue"):])
    assert "lean" not in kept[:kept.index("  # The blue ones")]


def test_a_name_twice_is_refused(tmp_path):
    path = tmp_path / "c.yaml"
    save_container("box", TAUGHT["box"], path)
    path.write_text(path.read_text() + "  box:\n    kind: box\n")
    with pytest.raises(ConfigError, match="malformed at two entries 'box'"):
        load_containers(path)


def test_an_inner_map_is_a_picture_beside_the_catalogue(tmp_path):
    heights = np.array([[0.0, 0.012, np.nan], [0.0031, 0.6, 0.00007]], np.float32)
    mapped = replace(TAUGHT["box"], inner_map=InnerMap(0.0005, heights))
    path = tmp_path / "c.yaml"
    save_container("tote", mapped, path)
    save_container("box", TAUGHT["box"], path)
    assert (tmp_path / "containers" / "tote.png").is_file()
    config = ReconstructorConfig(container="tote", container_catalogue=str(path))
    inner = configured_container(config).inner_map
    assert inner.pitch == 0.0005 and inner.heights.dtype == np.float32
    np.testing.assert_allclose(inner.heights, heights, atol=2.1e-5)
    # Whoever does not use it does not need it.
    (tmp_path / "containers" / "tote.png").write_bytes(b"no picture")
    assert configured_container(replace(config, container="box")).inner_map is None
    with pytest.raises(ConfigError, match="tote.png is no inner surface; expected the 16-bit"):
        configured_container(config)
    (tmp_path / "containers" / "tote.png").unlink()
    with pytest.raises(ConfigError, match="no inner surface .*tote.png"):
        configured_container(config)
    # Measured anew it has none.
    save_container("tote", TAUGHT["box"], path)
    assert "inner_map" not in path.read_text()
    assert configured_container(config).inner_map is None


def test_an_inner_map_without_its_scale_is_malformed(tmp_path):
    path = tmp_path / "c.yaml"
    save_container("tote", replace(TAUGHT["box"], inner_map=InnerMap(0.001, np.ones((2, 2)))),
                   path)
    text = path.read_text()
    for old, new, said in (("inner_pitch_m: 0.001", "inner_pitch_m: 0", "above 0 needed"),
                           ("inner_pitch_m:", "pitch:", "malformed at 'inner_pitch_m'")):
        path.write_text(text.replace(old, new))
        with pytest.raises(ConfigError, match=said):
            load_containers(path)
