# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: one file, or a folder with or without its metadata.yaml."""

from __future__ import annotations

import re
from pathlib import Path, PurePath
from typing import Any

import yaml

from stack_counter.bag.formats.opening import PACKED, SUFFIXES
from stack_counter.bag.scan_file import finished_recordings
from stack_counter.errors import BagError

METADATA = "metadata.yaml"
EXPECTED = "expected a rosbag2 folder or an .mcap, .db3 or .bag file"
# What recorders add to the name of a bag for each of its files; ROS 1 adds the time as well.
_PART = re.compile(r"((_|^)\d{4}(-\d\d){5})?_\d+$")


def find_recordings(path: Path) -> list[Path]:
    """Paths of the files of a bag, in the order in which they were recorded.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the folder holds no recording, more than one, or lacks a file.
    """
    if not path.exists():
        raise FileNotFoundError(f"no bag {path}; {EXPECTED}")
    if path.name == METADATA:
        path = path.parent
    if path.is_file():
        return [path]
    if (path / METADATA).is_file():
        return _listed_recordings(path)
    # A recorder that was killed leaves no metadata.yaml.
    paths = sorted(p for p in path.iterdir() if _bag_name(p) is not None and p.is_file())
    if not paths:
        raise BagError(f"no .mcap file in {path}, nor .db3 or .bag; it holds "
                       f"{sorted(p.name for p in path.iterdir())[:8]}")
    if len(scans := finished_recordings(path)) > 1:
        raise BagError(f"{path} holds the recordings of {len(scans)} scans; expected one: name "
                       f"its file, e.g. {scans[-1]}")
    if len(names := {_bag_name(p) for p in paths}) > 1:
        raise BagError(f"{path} holds {len(names)} recordings and no metadata.yaml; expected one: "
                       f"name its file, e.g. {paths[-1]}")
    return paths


def is_recording(path: Path) -> bool:
    """Whether a file is called as recordings are."""
    return _bag_name(path) is not None


def _bag_name(path: Path) -> str | None:
    """Name of the bag that a file is of; None: it is no recording."""
    name = path.name.removesuffix(PACKED)
    suffix = PurePath(name).suffix
    return _PART.sub("", name.removesuffix(suffix)) if suffix in SUFFIXES else None


def _listed_recordings(folder: Path) -> list[Path]:
    """Paths of the files that the folder's metadata.yaml names."""
    information = _read_metadata(folder)
    names = [PurePath(name).name for name in information["relative_file_paths"]]
    compression = str(information.get("compression_format") or "zstd")
    if compression != "zstd":
        raise BagError(f"{folder} is compressed by '{compression}'; expected none or zstd")
    paths = [_existing(folder / name) for name in names]
    missing = [name for name, path in zip(names, paths) if path is None]
    if missing or not names:
        raise BagError(f"{folder} lacks {', '.join(missing) or 'any file'}, named in its "
                       f"{METADATA}; expected all: copy what is missing there, or name a file, "
                       f"or remove {METADATA} to read what is left")
    return [path for path in paths if path is not None]


def _existing(path: Path) -> Path | None:
    """The file, or the same one compressed or unpacked since; None: there is none."""
    others = (path, path.with_name(path.name + PACKED),
              path.with_name(path.name.removesuffix(PACKED)))
    return next((other for other in others if other.is_file()), None)


def _read_metadata(folder: Path) -> dict[str, Any]:
    """The content of a rosbag2 folder's metadata.yaml."""
    path = folder / METADATA
    try:
        information = yaml.safe_load(path.read_text())["rosbag2_bagfile_information"]
        information["relative_file_paths"] = list(map(str, information["relative_file_paths"]))
        return information
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError,
            RecursionError) as error:
        raise BagError(f"{path} is not a rosbag2 metadata file: {str(error).splitlines()[0]}; "
                       "expected what a recorder writes: remove it, the recordings are read "
                       "without") from error
