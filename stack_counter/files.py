# SPDX-License-Identifier: Apache-2.0
"""Where the shipped files are, how weights are kept and how files that users keep are written."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import SafeConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode, Node
from ruamel.yaml.scalarstring import DoubleQuotedScalarString
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from stack_counter.errors import ConfigError, WeightsError

_COMMENT_COLUMN = 36  # of comments behind new keys, where those are not longer


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
    # A checkout (or an editable install) first, then what setup.py installs.
    folders = [Path(__file__).parents[1] / "config"]
    folders += [folder / "config" for folder in share_folders("stack_counter")]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise ConfigError(f"no {name} in {[str(f) for f in folders]}; expected it in one of them")


def share_folders(package: str) -> list[Path]:
    """Folders that may hold a ROS package's files; none of them needs to be there.

    They are below an ament prefix in a colcon workspace, below sys.prefix otherwise.
    """
    prefixes = (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix)
    return [Path(prefix) / "share" / package for prefix in prefixes if prefix]


def user_cache_folder() -> Path:
    """Folder for what can be made again; by the XDG base directories, it needs not be there."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stack_counter"


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


def write_weights(path: Path, file_format: str, tensors: Mapping[str, np.ndarray],
                  metadata: Mapping[str, str]) -> None:
    """Writes what `read_weights` reads, in one step; readable as any other file is.

    Raises:
        OSError: the file cannot be written.
    """
    # Not by safetensors' own `save_file`, whose files only their owner can read.
    contiguous = {name: np.ascontiguousarray(values) for name, values in tensors.items()}
    _replace_file(path, save(contiguous, metadata={"format": file_format, **metadata}))


def read_text(path: Path) -> str:
    """Reads the text of a file that users edit.

    Raises:
        ConfigError: it is no text.
        OSError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is no text: byte {error.start} is "
                          f"0x{error.object[error.start]:02x}; expected UTF-8") from error


def write_atomically(path: Path, text: str) -> None:
    """Replaces a file in one step: whoever reads meanwhile finds the old text or the new.

    Raises:
        OSError: the file cannot be written.
    """
    _replace_file(path, text.encode())


def _replace_file(path: Path, content: bytes) -> None:
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(content)
    unfinished.replace(path)


def parse_yaml(text: str) -> Any:
    """Values of a YAML file as plain Python types.

    Raises:
        ValueError: the text is no YAML, or a mapping has two entries of one name; one line.
    """
    parser = YAML(typ="safe", pure=True)
    parser.Constructor = _StrictConstructor
    try:
        return parser.load(text)
    except (YAMLError, RecursionError) as error:
        raise ValueError(" ".join(str(error).split())) from error


def edit_yaml_entry(text: str, section: str, name: str, values: Mapping[str, Any] | None,
                    comments: Mapping[str, str] | None = None) -> str:
    """Text of a YAML file `SECTION: NAME: {KEY: VALUE}` after a change of one entry.

    Every other line stays as it is. Of an entry that is there already, order and comments stay.

    Args:
        text: of the file, which `parse_yaml` accepts.
        section: key at the top whose value is the mapping of entries, or nothing.
        name: of the entry; a new one comes last.
        values: numbers, texts, lists of them, or lists of mappings, by key; None removes the
            entry.
        comments: what is written behind keys that are new.
    """
    document = _round_trip().load(text)
    entries = document[section]
    key = next((key for key in entries or () if str(key) == name), None)
    if not entries or entries.fa.flow_style():
        if not entries:
            entries = document[section] = CommentedMap()
        _change_entry(entries, name if key is None else key, values,
                      {} if entries else comments or {})
        return _dumped(document)
    # Take out the lines of the entry, or none behind the last one; put in those of the new one.
    lines = [f"{line}\n" for line in text.splitlines()]
    start, column = entries.lc.key(list(entries)[-1] if key is None else key)
    end = _end_of_entry(lines, start, column)
    start = end if key is None else start
    own = [line[column:] if line[:column].isspace() else line for line in lines[start:end]]
    entry = _parsed_alone("".join(own))
    _change_entry(entry, name if key is None else key, values, comments or {})
    changed = _dumped(entry, _indent_of(own)).splitlines() if entry else []
    lines[start:end] = [" " * column + line + "\n" if line else "\n" for line in changed]
    return "".join(lines)


class _StrictConstructor(SafeConstructor):
    """Makes plain Python values; refuses a mapping with two entries of one name."""

    def check_mapping_key(self, node: MappingNode, key_node: Node, mapping: Any, key: Any,
                          value: Any) -> bool:
        if str(key) in map(str, mapping):
            raise ValueError(f"two entries '{key}' (one needed), line "
                             f"{key_node.start_mark.line + 1}")
        return True


def _round_trip(indent: int = 2) -> YAML:
    """Reader and writer that keeps quotes, comments and order."""
    yaml = YAML(typ="rt")
    yaml.preserve_quotes = True
    yaml.width = 1 << 20  # characters: a line is never broken
    yaml.indent(mapping=indent, sequence=4, offset=2)
    return yaml


def _dumped(document: CommentedMap, indent: int = 2) -> str:
    buffer = io.StringIO()
    _round_trip(indent).dump(document, buffer)
    return buffer.getvalue()


def _end_of_entry(lines: list[str], start: int, column: int) -> int:
    """Number of the line behind a block entry whose key stands in that line and column.

    Comments that are indented no deeper than the key belong to what follows.
    """
    end = start + 1
    for number, line in enumerate(lines[start + 1:], start + 1):
        content = line.strip()
        deeper = len(line) - len(line.lstrip()) > column
        if content and deeper:
            end = number + 1
        elif content and not content.startswith("#"):
            break
    return end


def _indent_of(lines: list[str]) -> int:
    """Columns by which the keys of an entry stand behind its name; 2 where there are none."""
    return next((len(line) - len(line.lstrip()) for line in lines[1:]
                 if line.strip() and not line.lstrip().startswith("#")), 2)


def _parsed_alone(text: str) -> CommentedMap:
    """The entry of these lines; empty where it refers to others and has to be written anew."""
    try:
        return _round_trip().load(text) or CommentedMap()
    except YAMLError:
        return CommentedMap()


def _change_entry(entries: CommentedMap, key: Any, values: Mapping[str, Any] | None,
                  comments: Mapping[str, str]) -> None:
    """Makes an entry hold `values`; what is equal already is not touched."""
    if values is None:
        del entries[key]
        return
    if key not in entries:
        entries[DoubleQuotedScalarString(key) if isinstance(key, str) else key] = CommentedMap()
    entry = entries[key]
    for old in [old for old in entry if old not in values]:
        del entry[old]
    for name, value in values.items():
        new, before = name not in entry, entry.get(name)
        if isinstance(before, list) and isinstance(value, list) and before \
                and before == value[:len(before)]:
            before.extend(_styled(item) for item in value[len(before):])
        elif isinstance(before, list) and isinstance(value, list) and value \
                and value == before[:len(value)]:
            del before[len(value):]
        elif new or before != value:
            entry[name] = _styled(value)
        if new and name in comments and not entry.fa.flow_style():
            entry.yaml_add_eol_comment(comments[name], name, column=_COMMENT_COLUMN)


def _styled(value: Any) -> Any:
    """A value as it is written: texts in quotes, lists and their mappings on one line."""
    if isinstance(value, str):
        return DoubleQuotedScalarString(value)
    if isinstance(value, Mapping):
        styled = CommentedMap((key, _styled(item)) for key, item in value.items())
        styled.fa.set_flow_style()
        return styled
    if isinstance(value, (list, tuple)):
        items = CommentedSeq(_styled(item) for item in value)
        if not any(isinstance(item, Mapping) for item in value):
            items.fa.set_flow_style()
        return items
    return value
