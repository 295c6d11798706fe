"""The part catalogue: what is known of each part (config/parts.yaml)."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import yaml

from stack_counter.counting import check_unit_volume
from stack_counter.errors import ConfigError, PartError
from stack_counter.files import config_path, write_atomically
from stack_counter.parts.counted_scan import CountedScan
from stack_counter.parts.gamma_model import PartModels, read_models

MOST_FRICTION = 2.0
_HEAD = """\
# The part catalogue: what `--part NAME`, the parameter `part` and the action's goal look up.
# `stack-counter part` writes it and keeps entries but not your comments. Of a part, only
# unit_volume_cm3 must be there:
#   unit_volume_cm3      volume of one part, cm3, above 0
#   unit_volume_std_cm3  its standard deviation, cm3; 0 where it is exact
#   mesh                 CAD file, from this file's folder
#   density_g_cm3        of the material, for bins that are weighed
#   friction             least and most, of parts on each other
#   gamma_prior          file of what simulated piles of the part say, from this file's folder
#   tuned                file of the network's last layers, adapted to those piles
#   note                 where it comes from
#   counted              bins of it that were counted: `stack-counter part calibrate` writes these
"""


@dataclass(frozen=True)
class Part:
    """One part.

    Attributes:
        unit_volume: v, m3; `unit_volume_std` its standard deviation, m3.
        name: in the catalogue; empty where only v was given.
        mesh, gamma_prior, tuned: files; None where there are none.
        density: kg/m3; 0 where not known.
        friction: least and most; None where not known.
        note: where it comes from.
        counted: calibration history, oldest first.
        overridden: v was given, and is not that by which the catalogue knows more of the part.
    """

    unit_volume: float
    name: str = ""
    unit_volume_std: float = 0.0
    mesh: Path | None = None
    density: float = 0.0
    friction: tuple[float, float] | None = None
    gamma_prior: Path | None = None
    tuned: Path | None = None
    note: str = ""
    counted: tuple[CountedScan, ...] = ()
    overridden: bool = False

    @cached_property
    def models(self) -> PartModels | None:
        """What its simulated piles say; None where there are none.

        Raises:
            PartError: the file cannot be read.
        """
        return read_models(self.gamma_prior) if self.gamma_prior else None

    @property
    def relative_std(self) -> float:
        """Standard deviation of v over v."""
        return self.unit_volume_std / self.unit_volume


def load_parts(path: Path | None = None) -> dict[str, Part]:
    """Parts by name; None is the shipped catalogue.

    Raises:
        ConfigError: the catalogue is missing or malformed.
    """
    path = path or config_path("parts.yaml")
    try:
        now = path.stat()
        return dict(_parts(path, (now.st_mtime_ns, now.st_ino, now.st_size)))
    except OSError as error:
        raise ConfigError(f"no part catalogue {path}: {error.strerror}") from error


@lru_cache(maxsize=8)
def _parts(path: Path, version: tuple[int, ...]) -> dict[str, Part]:
    """Those of a version of the file: nodes ask for every volume."""
    return _parsed(path.read_text(), path)


def _parsed(text: str, path: Path) -> dict[str, Part]:
    try:
        document = yaml.load(text, _OnceLoader)
        if not isinstance(document, dict) or set(document) != {"parts"}:
            raise ValueError(f"{document if not isinstance(document, dict) else sorted(document)}")
        return {str(name): _part(str(name), entry, path.parent)
                for name, entry in (document["parts"] or {}).items()}
    except (yaml.YAMLError, AttributeError, KeyError, ValueError) as error:
        line = " ".join(str(error).split())
        raise ConfigError(f"{path} is malformed at {line}; expected 'parts: NAME: "
                          "unit_volume_cm3: NUMBER' and what the head of config/parts.yaml "
                          "names") from error


def resolve_part(name: str, unit_volume: float, catalogue: str = "") -> Part:
    """The part that is named, or one of which no more than v is known.

    Args:
        name: in the catalogue, or "".
        unit_volume: v, m3; 0 where not given. One that is not the named part's own overrides all
            that is known of it.
        catalogue: file; empty is the shipped one.

    Raises:
        PartError: neither is given, the name is unknown, or the volume is no positive number.
        ConfigError: as `load_parts`.
    """
    if not name and not unit_volume:
        raise PartError("no part named and no unit volume given; expected one of them")
    parts = load_parts(Path(catalogue) if catalogue else None) if name else {}
    if name in parts and (not unit_volume or math.isclose(
            unit_volume, parts[name].unit_volume, rel_tol=1e-9)):
        part = parts[name]
        part.models  # noqa: B018 - or say why its file cannot be read
        return part
    if unit_volume:
        more = name in parts and (parts[name].gamma_prior or parts[name].counted)
        return Part(check_unit_volume(unit_volume), name, overridden=bool(more))
    raise PartError(f"unknown part '{name}'; expected one of {sorted(parts)}")


def save_part(part: Part, path: Path) -> None:
    """Writes a part into a catalogue, which is made if it is not there.

    Raises:
        ConfigError: the catalogue is malformed.
    """
    parts = load_parts(path) if path.exists() else {}
    parts[part.name] = part
    _write(parts, path)


def remove_part(name: str, path: Path) -> None:
    """Takes a part out of a catalogue.

    Raises:
        ConfigError: the catalogue is malformed.
        PartError: it is not there.
    """
    parts = load_parts(path)
    if name not in parts:
        raise PartError(f"unknown part '{name}'; expected one of {sorted(parts)}")
    del parts[name]
    _write(parts, path)


def _write(parts: dict[str, Part], path: Path) -> None:
    text = _HEAD + "parts:\n" + "".join(_entry(parts[name], path.parent) for name in sorted(parts))
    _parsed(text, path)  # or say what could not be read again, before anything is lost
    write_atomically(path, text)


class _OnceLoader(yaml.SafeLoader):
    """Refuses two entries of one name."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """The mapping. Raises ValueError where a key comes twice."""
        keys = [str(self.construct_object(key, deep=True)) for key, _ in node.value]
        twice = [key for i, key in enumerate(keys) if key in keys[:i]]
        if twice:
            raise ValueError(f"two entries '{twice[0]}' (one needed)")
        return super().construct_mapping(node, deep)


_KEYS = ("unit_volume_cm3", "unit_volume_std_cm3", "mesh", "density_g_cm3", "friction",
         "gamma_prior", "tuned", "note", "counted")


def _part(name: str, entry: dict[str, Any], folder: Path) -> Part:
    try:
        return _checked_part(name, entry, folder)
    except (TypeError, ValueError, PartError) as error:
        raise ValueError(f"'{name}': {error}") from error


def _checked_part(name: str, entry: dict[str, Any], folder: Path) -> Part:
    if not isinstance(entry, dict):
        raise ValueError(f"{entry!r} (keys needed)")
    wrong = [key for key in entry if key not in _KEYS]
    if wrong:
        raise ValueError(f"key '{wrong[0]}' (one of {', '.join(_KEYS)} needed)")
    if "unit_volume_cm3" not in entry:
        raise ValueError("no unit_volume_cm3")
    volume, std, density = (_number(entry.get(key, 0.0), key) for key in (
        "unit_volume_cm3", "unit_volume_std_cm3", "density_g_cm3"))
    mesh, prior, tuned = (folder / str(entry[key]) if entry.get(key) else None
                          for key in ("mesh", "gamma_prior", "tuned"))
    counted = entry.get("counted") or []
    if not isinstance(counted, list):
        raise ValueError(f"counted {counted!r} (a list needed)")
    return Part(check_unit_volume(volume * 1e-6), name, std * 1e-6, mesh, density * 1e3,
                _friction(entry.get("friction")), prior, tuned, str(entry.get("note", "")),
                tuple(_counted(scan) for scan in counted))


def _number(value: object, what: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"{what} {value!r} (a number, 0 or more, needed)")
    return number


def _friction(pair: object) -> tuple[float, float] | None:
    if pair is None:
        return None
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError(f"friction {pair!r} (least and most needed)")
    low, high = (_number(value, "friction") for value in pair)
    if not low <= high <= MOST_FRICTION:
        raise ValueError(f"friction {pair} (least and most, 0 to {MOST_FRICTION:g}, needed)")
    return low, high


def _counted(entry: dict[str, Any]) -> CountedScan:
    names = [f.name for f in fields(CountedScan)]
    if not isinstance(entry, dict) or sorted(entry) != sorted(names):
        raise ValueError(f"counted {entry} (keys {', '.join(names)} needed)")
    scan = CountedScan(**entry)
    return replace(scan, inner_size_m=tuple(float(x) for x in scan.inner_size_m)).checked()


def _entry(part: Part, folder: Path) -> str:
    """The YAML of one part."""
    values: dict[str, Any] = {"unit_volume_cm3": float(f"{part.unit_volume * 1e6:.16g}")}
    if part.unit_volume_std:
        values["unit_volume_std_cm3"] = float(f"{part.unit_volume_std * 1e6:.4g}")
    for key in ("mesh", "gamma_prior", "tuned"):
        path = getattr(part, key)
        if path is not None:
            values[key] = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
    if part.density:
        values["density_g_cm3"] = part.density / 1e3
    if part.friction is not None:
        values["friction"] = list(part.friction)
    if part.note:
        values["note"] = part.note
    lines = [f"    {key}: {json.dumps(value)}" for key, value in values.items()]
    if part.counted:
        lines += ["    counted:", *(f"      - {scan.as_flow()}" for scan in part.counted)]
    return "\n".join([f"  {json.dumps(part.name)}:", *lines]) + "\n"
