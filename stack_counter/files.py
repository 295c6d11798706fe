# SPDX-License-Identifier: Apache-2.0
"""Where the shipped files are, how weights are read and how files that users keep are written."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from stack_counter.errors import ConfigError, WeightsError


@dataclass(frozen=True, eq=False)
class WeightsFile:
    """Content of a safetensors file.

    Attributes:
        tensors: arrays by name, of the dtype in which they are stored, all finite.
        metadata: texts by key, `format` among them.
    """

    tensors: dict[str, np.ndarray]
    metadata: dict[str, str]


def config_path(name: str) -> Path:
    """Path of a file of `config/`.

    Raises:
        ConfigError: no folder of configuration files holds it.
    """
    # A checkout (or an editable install) first, then what setup.py installs: below an ament
    # prefix in a colcon workspace, below sys.prefix otherwise.
    folders = [Path(__file__).parents[1] / "config"]
    folders += [Path(prefix) / "share" / "stack_counter" / "config" for prefix in
                (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix) if prefix]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise ConfigError(f"no {name} in {[str(f) for f in folders]}; expected it in one of them")


def shipped_weights(name: str) -> Path:
    """Path of a file of weights or of a fitted model that comes with the package."""
    return Path(__file__).parent / "weights" / name


def read_weights(path: Path, file_format: str) -> WeightsFile:
    """Reads a safetensors file; nothing in it is ever executed.

    Args:
        path: of the file.
        file_format: what its metadata must name as `format`.

    Raises:
        WeightsError: the file is missing, not safetensors, cut short, of another format, or
            holds numbers that are not finite.
    """
    if not path.is_file():
        raise WeightsError(f"no weights file {path}; expected a safetensors file")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is not a whole safetensors file: {error}") from error
    if metadata.get("format") != file_format:
        raise WeightsError(f"{path} is '{metadata.get('format')}'; expected '{file_format}'")
    for name, values in tensors.items():
        if not np.isfinite(values).all():
            raise WeightsError(f"{path}: {name} holds NaN or infinite numbers; expected finite "
                               "ones")
    return WeightsFile(tensors, metadata)


def write_atomically(path: Path, text: str) -> None:
    """Replaces a file in one step: whoever reads meanwhile finds the old text or the new.

    Raises:
        OSError: the file cannot be written.
    """
    unfinished = path.with_suffix(".part")
    unfinished.write_text(text)
    unfinished.replace(path)
