# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter import`: a folder of pictures becomes a bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from stack_counter.errors import ConfigError

_EPILOG = """
a folder with transforms.json has poses; other pictures get theirs by structure from motion, and
their scale from what is named by --reference (docs/pictures.md), lengths in metres:
  --reference "a.jpg:120,340 b.jpg:131,322 to a.jpg:900,410 c.jpg:870,402 = 0.30"
                                             two points, each marked in two or more pictures
  --reference "aruco DICT_4X4_50 = 0.05"     ArUco markers, by their side
  --reference "charuco DICT_5X5_100 7x5 0.022 = 0.030"
                                             a ChArUco board: squares, marker's and square's side
"""


def add_import(commands: argparse._SubParsersAction) -> None:
    """Adds `import` to the commands of the command line."""
    importer = commands.add_parser(
        "import", help="a folder of pictures, with poses or without, to bag", epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    importer.add_argument("scene", type=Path, help="folder with transforms.json, or of pictures")
    importer.add_argument("out", type=Path, help="bag to write (a new folder)")
    importer.add_argument("--reference", action="append", default=[], metavar="TEXT",
                          help="what gives pictures without poses their scale; may be repeated")
    importer.set_defaults(run=_import)


def _import(options: argparse.Namespace) -> int:
    has_poses = (options.scene / "transforms.json").exists()
    if options.reference and has_poses:
        raise ConfigError(f"{options.scene} has poses in transforms.json, so --reference would "
                          "not be used; leave it out, or import its folder of pictures alone")
    if options.reference:
        from stack_counter.pictures.import_pictures import import_pictures

        print(import_pictures(options.scene, options.out, options.reference))
        return 0
    _require_poses(options.scene, has_poses)
    from stack_counter.bag.nerfstudio import import_scene

    print(import_scene(options.scene, options.out))
    return 0


def _require_poses(scene: Path, has_poses: bool) -> None:
    """Raises ConfigError: these are pictures without poses, and nothing gives their scale."""
    from stack_counter.pictures.folder import list_picture_files

    # Poses under another name are named by what reads them.
    has_poses = has_poses or any(scene.glob("transforms*.json"))
    count = 0 if has_poses or not scene.is_dir() else len(list_picture_files(scene))
    if count:
        raise ConfigError(f"{scene} holds {count} pictures and no transforms.json; expected "
                          "--reference for pictures without poses, e.g. --reference "
                          "'aruco DICT_4X4_50 = 0.05' (stack-counter import --help)")
