"""What recordings of scans are called: how they are told from all other files."""

from __future__ import annotations

import re
import time
from pathlib import Path

FACTS = "stack_counter"  # name of the mcap metadata that say what was recorded
PART = ".part"  # at the end of the name while the file is written
_CUT = ".cut"
# As the names made here and no others: the disk bound deletes by this.
_NAME = re.compile(r"scan_\d{8}-\d{6}-\d{3}_[A-Za-z0-9_-]{1,40}(\.cut)?\.mcap")


def file_name(scan_id: str, now_ns: int) -> str:
    """Name of a finished recording.

    The time (ns since 1970, written in UTC) comes first, so that names sort by age. No path
    leaves the folder, whatever the scan is called.
    """
    second, rest = divmod(now_ns, 10**9)
    when = time.strftime("%Y%m%d-%H%M%S", time.gmtime(second))
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", scan_id)[:40] or "scan"
    return f"scan_{when}-{rest // 10**6:03d}_{name}.mcap"


def cut(path: Path) -> Path:
    """The path of a finished recording that ended before its scan."""
    return path.with_suffix(f"{_CUT}{path.suffix}")


def finished(folder: Path) -> list[Path]:
    """The finished recordings of a folder, oldest first."""
    return sorted(p for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_file())


def unfinished(folder: Path) -> list[Path]:
    """The recordings that are being written, or were when their writer was killed."""
    return sorted(p for p in folder.glob(f"*{PART}")
                  if _NAME.fullmatch(p.name.removesuffix(PART)) and p.is_file())
