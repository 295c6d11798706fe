# SPDX-License-Identifier: Apache-2.0
"""What the fuzzer feeds: settings, catalogues, rigs, prompts, meshes and folders of pictures."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import trimesh
from kits.known_parts import COUNTED, gamma_model
from kits.nerfstudio import add_images, make_scene

from stack_counter.bag.nerfstudio import import_scene
from stack_counter.bag.nerfstudio.images import read_cutouts, read_depth, read_grey, read_jpeg
from stack_counter.bridges.settings import load_bridges
from stack_counter.config import CollectorConfig, ReconstructorConfig, load_config
from stack_counter.container.catalogue import (
    TaughtContainer,
    configured_container,
    describe_container,
    load_containers,
    save_container,
)
from stack_counter.container.inner_map import read_inner_map
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall
from stack_counter.errors import ConfigError, StackCounterError
from stack_counter.files import config_path
from stack_counter.parts.catalogue import Part, load_parts, remove_part, save_part
from stack_counter.parts.part_models import PartModels, read_models
from stack_counter.segmentation.prompts import read_prompts
from stack_counter.teaching.part_mesh import load_part_mesh
from stack_counter.types import InnerMap
from stack_counter.views.rig import load_rig

ROOT = Path(__file__).parents[2]
BOX = BoxWall(np.array([0, 0, 0, 0.3, 0.2, 0.14]))
INNER = InnerMap(0.02, np.full((6, 8), 0.01, np.float32))
CONTAINERS = {
    "box": TaughtContainer(BOX, 0.004, 0.006, 0.12, "a", INNER),
    "round": TaughtContainer(RoundWall(np.array([0, 0, 0.1, 0.05, -1])), 0.003, 0.0, 0.1, "b: #"),
    "free": TaughtContainer(FreeWall(np.linspace(0.1, 0.2, 27), np.zeros(2)), 0.004, 0.003, 0.1),
}
PROMPTS = (b"parts:\n  boxes: [[210, 120, 430, 360]]  # around all\n  points: [[300, 240.5]]\n"
           b"container: {boxes: [[190, 100, 450, 380]]}\nbackground: {points: [[20, 20]]}\n")


# --- YAML -------------------------------------------------------------------------------------

def part_catalogues(folder):
    path = folder / "parts.yaml"
    save_part(Part(6e-6, "nut", 1e-8, folder / "nut.stl", 7850.0, (0.2, 0.7), note='a "b": #',
                   counted=(COUNTED,), outer_size_m=(0.03, 0.03, 0.01)), path)
    return [path.read_bytes(), config_path("parts.yaml").read_bytes(),
            b"parts: {a: {unit_volume_cm3: 1, note: &n x}, b: {unit_volume_cm3: 2, note: *n}}\n"]


def use_parts(path):
    """Looks parts up; adds one and takes it out again, which leaves the others as they were."""
    before = load_parts(path)
    save_part(Part(1e-6, "new part"), path)
    assert {**before, "new part": Part(1e-6, "new part")} == load_parts(path)
    remove_part("new part", path)
    assert {name: part for name, part in before.items() if name != "new part"} == load_parts(path)


def gamma_priors(folder):
    PartModels("network 7", gamma_model(), gamma_model(0.2), "64 piles").write(folder / "a.json")
    return [(folder / "a.json").read_bytes()]


def use_gamma_prior(path):
    read_models(path)


def container_catalogues(folder):
    for name, taught in CONTAINERS.items():
        save_container(name, taught, folder / "containers.yaml")
    return [(folder / "containers.yaml").read_bytes()]


def use_containers(path):
    """Looks containers up, and adds one."""
    if not (path.parent / "containers").exists():
        container_catalogues(path.parent / "made")
        shutil.move(path.parent / "made" / "containers", path.parent)
    found = load_containers(path)
    for name, taught in found.items():
        describe_container(name, taught)
        try:
            configured_container(ReconstructorConfig(container=name,
                                                     container_catalogue=str(path)))
        except ConfigError:
            pass
    save_container("new", CONTAINERS["round"], path)
    assert list(load_containers(path)) == [*(n for n in found if n != "new"), "new"]


def use_rig(path):
    load_rig(CollectorConfig(rig=str(path)))


def use_prompts(path):
    """Reads prompts from a file, and as the text of a parameter."""
    text = path.read_bytes().decode(errors="replace")
    read_prompts(str(path)).check(640, 480)
    if text.strip().startswith("{"):
        read_prompts(text)


# --- meshes -----------------------------------------------------------------------------------

def meshes(suffix):
    """What makes the bytes of a box and of a ring in a format of trimesh's."""
    def make(folder):
        for mesh in (trimesh.creation.box((20, 30, 40)),
                     trimesh.creation.annulus(8, 12, 5, sections=6)):
            mesh.export(folder / f"a{suffix}")
            yield (folder / f"a{suffix}").read_bytes()
            if suffix in (".stl", ".ply"):
                form = {".stl": {"file_type": "stl_ascii"}, ".ply": {"encoding": "ascii"}}[suffix]
                mesh.export(folder / f"a{suffix}", **form)
                yield (folder / f"a{suffix}").read_bytes()
    return make


def step_files(_):
    return [(ROOT / "test" / "teaching" / "block.step").read_bytes()]


def use_mesh(path):
    load_part_mesh(path)


# --- folders of pictures ----------------------------------------------------------------------

def transform_files(folder):
    """transforms.json of nerfstudio's, Instant NGP's, and with depth and masks."""
    for number, options in enumerate((
            {}, {"camera_angle_x": 0.9, "remove": ("fl_x", "fl_y"), "aabb_scale": 4},
            {"frame_keys": {"depth_file_path": "depth/{}.png", "mask_path": "masks/{}.png"}},
            {"applied_scale": 2.0, "applied_transform": np.eye(4)[:3].tolist(),
             "camera_model": "OPENCV_FISHEYE", "distortion_params": [0.1, 0, 0, 0, 0, 0]})):
        yield (make_scene(folder / str(number), **options) / "transforms.json").read_bytes()


def use_scene(path):
    """Imports a folder of pictures whose transforms.json this file is."""
    scene, out = path.parent / "scene", path.parent / "out"
    if not scene.exists():
        make_scene(scene)
        add_images(scene, "depth", np.full((120, 160), 500, np.uint16))
        add_images(scene, "masks", np.full((120, 160), 255, np.uint8))
    shutil.copyfile(path, scene / "transforms.json")
    shutil.rmtree(out, ignore_errors=True)
    import_scene(scene, out)


def image_files(_):
    """Pictures, depth, labels and cutouts of a few pixels, as PNG and JPEG."""
    grey = np.random.default_rng(0).integers(0, 255, (6, 8), np.uint8)
    images = (grey, np.dstack([grey] * 3), np.dstack([grey] * 4), grey.astype(np.uint16) * 9)
    return [cv2.imencode(".png", image)[1].tobytes() for image in images] + [
        cv2.imencode(".jpg", image)[1].tobytes() for image in images[:2]]


def use_image(path):
    """Reads an image as a picture, and as all else that an image file may be."""
    for read in (lambda: read_depth(path, (8, 6), None), lambda: read_grey(path, (8, 6)),
                 lambda: read_cutouts(path, None, (8, 6)), lambda: read_inner_map(path, 0.01)):
        try:
            read()
        except StackCounterError:  # it is another kind of image
            pass
    read_jpeg(path)


def use_bridges(path):
    load_bridges(path)


def use_settings(path):
    load_config(path)
