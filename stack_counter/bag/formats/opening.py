# SPDX-License-Identifier: Apache-2.0
"""Opens a file of a recording by what it begins with, whatever it is called.

A file that is compressed as a whole is unpacked first: its messages are read in the order of their
times, by an index at the end or by a database. That takes room for the unpacked file in the folder
of temporary files (`TMPDIR`).
"""

from __future__ import annotations

import errno
import shutil
import tempfile
import weakref
from pathlib import Path

import zstandard

from stack_counter.bag.formats import mcap_index, ros1_file, sqlite_file
from stack_counter.bag.formats.mcap_file import McapFile
from stack_counter.bag.formats.recording_file import ZSTD_MAGIC, RecordingFile
from stack_counter.bag.formats.ros1_file import Ros1File
from stack_counter.bag.formats.sqlite_file import SqliteFile
from stack_counter.errors import BagError

SUFFIXES = (".mcap", ".db3", ".bag")
PACKED = ".zstd"
_FORMATS = ((mcap_index.MAGIC, McapFile), (sqlite_file.MAGIC, SqliteFile),
            (ros1_file.MAGIC, Ros1File))
# Bytes of the longest head of a compressed frame.
_FRAME_HEAD_BYTES = 18


def open_recording(path: Path) -> RecordingFile:
    """Opens a file of a recording.

    Raises:
        BagError: the file is of no known format, or cannot be read.
    """
    with open(path, "rb") as file:
        head = file.read(16)
    if head.startswith(ZSTD_MAGIC):
        return _open_packed(path)
    for magic, kind in _FORMATS:
        if head.startswith(magic):
            return kind(path)
    if not head:
        raise BagError(f"{path} is empty: its recorder was ended before it wrote; expected an "
                       f"{', '.join(SUFFIXES)} file")
    raise BagError(f"{path} is no recording: it begins with {head!r}; expected an "
                   f"{', '.join(SUFFIXES)} file, not encrypted, as it is or compressed by zstd")


def _open_packed(packed: Path) -> RecordingFile:
    """Opens a compressed file; its temporary copy is removed with what is returned."""
    folder = Path(tempfile.mkdtemp(prefix="stack_counter_"))
    try:
        path = folder / packed.name.removesuffix(PACKED)
        _unpack(packed, path)
        recording = open_recording(path)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(recording, shutil.rmtree, folder, ignore_errors=True)
    return recording


def _unpack(packed: Path, path: Path) -> None:
    """Writes the content of a compressed file; of one cut short, what can be read.

    Raises:
        BagError: there is no room, or nothing can be unpacked.
    """
    with open(packed, "rb") as source, open(path, "wb") as target:
        free = shutil.disk_usage(path.parent).free
        try:
            need = zstandard.frame_content_size(source.read(_FRAME_HEAD_BYTES))
            if need > free:
                raise _no_room(packed, path, f"{need / 1e9:.1f} GB", free)
            source.seek(0)
            with zstandard.ZstdDecompressor().stream_reader(source) as content:
                shutil.copyfileobj(content, target, 1 << 20)
        except zstandard.ZstdError as error:
            if not target.tell():
                raise BagError(f"{packed} cannot be unpacked: {error}; expected zstd") from error
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise _no_room(packed, path, f"more than {free / 1e9:.1f} GB", free) from error
        if not target.tell():
            raise BagError(f"{packed} is cut short: nothing of it can be unpacked; expected a "
                           "whole file")


def _no_room(packed: Path, path: Path, need: str, free: int) -> BagError:
    return BagError(f"{packed} unpacks to {need}; {path.parent.parent} has {free / 1e9:.1f} GB "
                    f"free: set TMPDIR to a folder with more room, or unpack the file beside "
                    "itself (`zstd -d`)")
