# SPDX-License-Identifier: Apache-2.0
"""The part catalogue: what is known of each part (config/parts.yaml)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from stack_counter.counting import check_unit_volume
from stack_counter.errors import ConfigError, PartError
from stack_counter.files import (
    config_path,
    edit_yaml_entry,
    parse_yaml,
    read_text,
    write_atomically,
)
from stack_counter.parts.counted_scan import CountedScan
from stack_counter.parts.entry_checks import (
    checked_friction,
    checked_measures,
    checked_number,
    checked_piece_weight,
    checked_scan,
    checked_size,
    measures_entry,
    piece_weight_entry,
)
from stack_counter.parts.part_models import PartModels, read_models
from stack_counter.types import KnownForm, MeshMeasures
from stack_counter.weighing.joined_count import PieceWeight

_NEW_CATALOGUE = """\
# The part catalogue: what `--part NAME`, the parameter `part` and the action's goal look up.
# `stack-counter part` writes entries and keeps your comments. Of a part, only unit_volume_cm3
# must be there:
#   unit_volume_cm3      volume of one part, cm3, above 0
#   unit_volume_std_cm3  its standard deviation, cm3; 0 where it is exact
#   size_mm              sides of the box around one part, mm, in any order
#   mesh                 CAD file, from this file's folder
#   mesh_measures        what `stack-counter part add` measured of it
#   density_g_cm3        of the material, for bins that are weighed
#   piece_weight_g       mean weight of a piece, g, for a scale under the container
#   piece_weight_sd_g    standard deviation from piece to piece, g; 1% of the mean if not given
#   piece_weight_pieces  number of pieces that were weighed for the mean; 10 if not given
#   friction             least and most, of parts on each other
#   gamma_prior          file of what simulated piles of the part say, from this file's folder
#   tuned                file of the network's last layers, adapted to those piles
#   note                 where it comes from
#   counted              bins of it that were counted: `stack-counter part calibrate` writes these
parts:
"""
_KEYS = ("unit_volume_cm3", "unit_volume_std_cm3", "size_mm", "mesh", "mesh_measures",
         "density_g_cm3", "piece_weight_g", "piece_weight_sd_g", "piece_weight_pieces", "friction",
         "gamma_prior", "tuned", "note", "counted")
_FILE_KEYS = ("mesh", "gamma_prior", "tuned")


@dataclass(frozen=True)
class Part:
    """What is known of one part.

    Attributes:
        unit_volume: volume v of one part, m3.
        name: of the part in the catalogue; empty where only v was given.
        unit_volume_std: standard deviation of v, m3; 0 where v is exact.
        mesh: CAD file; None where there is none.
        density: of the material, kg/m3; 0 where it is not known.
        friction: least and most, of parts on each other; None where it is not known.
        gamma_prior: file of the models fitted to simulated piles; None where there is none.
        tuned: file of the network's last layers, adapted to those piles; None where there is none.
        note: text that names where the part comes from.
        counted: calibration history, oldest scan first.
        overridden: whether another v was given than that by which the catalogue knows more of
            the part.
        outer_size_m: sides of the box around the part, metres; None where they are not known.
        mesh_measures: measures of its mesh; None where there is none.
        piece_weight: weight of a piece; None where it is not known.
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
    outer_size_m: tuple[float, float, float] | None = None
    mesh_measures: MeshMeasures | None = None
    piece_weight: PieceWeight | None = None

    @property
    def form(self) -> KnownForm:
        """What is known of its form beside v."""
        return KnownForm(self.outer_size_m, self.mesh_measures)

    @cached_property
    def models(self) -> PartModels | None:
        """Models of gamma fitted to the part's simulated piles; None where there are none.

        Raises:
            PartError: the file cannot be read.
        """
        return read_models(self.gamma_prior) if self.gamma_prior else None

    def with_models_read(self) -> Part:
        """This part, after its models were read: they stay in memory from then on.

        Raises:
            PartError: the file cannot be read.
        """
        _ = self.models
        return self

    @property
    def relative_std(self) -> float:
        """Standard deviation of v over v."""
        return self.unit_volume_std / self.unit_volume


def load_parts(path: Path | None = None) -> dict[str, Part]:
    """Reads a catalogue; None is the shipped one.

    Returns:
        Parts by name, in the order of the file.

    Raises:
        ConfigError: the catalogue is missing or malformed.
    """
    path = path or config_path("parts.yaml")
    try:
        stat = path.stat()
        return dict(_cached_parts(path, (stat.st_mtime_ns, stat.st_ino, stat.st_size)))
    except OSError as error:
        raise ConfigError(f"no part catalogue {path}: {error.strerror}") from error


def find_part(name: str, path: Path) -> Part | None:
    """The part of that name; None where the catalogue does not hold it, or is not there yet.

    Raises:
        ConfigError: the catalogue is malformed.
    """
    return load_parts(path).get(name) if path.exists() else None


def save_part(part: Part, path: Path) -> None:
    """Writes a part into a catalogue, which is made if it is not there.

    Raises:
        ConfigError: the catalogue is malformed, or would be with this part.
    """
    if path.exists():
        load_parts(path)  # raises what is wrong with it before it is changed
    _write_entry(part.name, _entry_of(part, path.parent), path)


def remove_part(name: str, path: Path) -> None:
    """Takes a part out of a catalogue.

    Raises:
        ConfigError: the catalogue is malformed.
        PartError: the catalogue does not hold the part.
    """
    parts = load_parts(path)
    if name not in parts:
        raise PartError(f"unknown part '{name}'; expected one of {sorted(parts)}")
    _write_entry(name, None, path)


def _write_entry(name: str, values: dict[str, Any] | None, path: Path) -> None:
    text = read_text(path) if path.exists() else _NEW_CATALOGUE
    text = edit_yaml_entry(text, "parts", name, values)
    _parse_parts(text, path)  # raises what could not be read again, before anything is lost
    write_atomically(path, text)


def _entry_of(part: Part, folder: Path) -> dict[str, Any]:
    """What the catalogue in a folder holds of a part, by key."""
    values: dict[str, Any] = {"unit_volume_cm3": float(f"{part.unit_volume * 1e6:.16g}")}
    if part.unit_volume_std:
        values["unit_volume_std_cm3"] = float(f"{part.unit_volume_std * 1e6:.4g}")
    if part.outer_size_m is not None:
        values["size_mm"] = [float(f"{1e3 * side:.6g}") for side in part.outer_size_m]
    if part.mesh_measures is not None:
        values["mesh_measures"] = measures_entry(part.mesh_measures)
    for key in _FILE_KEYS:
        path = getattr(part, key)
        if path is not None:
            values[key] = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
    if part.density:
        values["density_g_cm3"] = part.density / 1e3
    if part.piece_weight is not None:
        values |= piece_weight_entry(part.piece_weight)
    if part.friction is not None:
        values["friction"] = list(part.friction)
    if part.note:
        values["note"] = part.note
    if part.counted:
        values["counted"] = [scan.as_entry() for scan in part.counted]
    return values


@lru_cache(maxsize=8)
def _cached_parts(path: Path, version: tuple[int, ...]) -> dict[str, Part]:
    """Parts of one version of a file; nodes ask for them with every volume."""
    return _parse_parts(read_text(path), path)


def _parse_parts(text: str, path: Path) -> dict[str, Part]:
    try:
        document = parse_yaml(text)
        if not isinstance(document, dict) or set(document) != {"parts"}:
            raise ValueError(f"{document if not isinstance(document, dict) else sorted(document)}")
        return {str(name): _part_of(str(name), entry, path.parent)
                for name, entry in (document["parts"] or {}).items()}
    except (AttributeError, ValueError) as error:
        line = " ".join(str(error).split())
        raise ConfigError(f"{path} is malformed at {line}; expected 'parts: NAME: "
                          "unit_volume_cm3: NUMBER' and what the head of config/parts.yaml "
                          "names") from error


def _part_of(name: str, entry: Any, folder: Path) -> Part:
    """Makes a part of its entry; ValueError names the part and what is wrong with it."""
    try:
        return _checked_part(name, entry, folder)
    except (TypeError, ValueError, OverflowError, PartError) as error:
        raise ValueError(f"'{name}': {error}") from error


def _checked_part(name: str, entry: Any, folder: Path) -> Part:
    if not isinstance(entry, dict):
        raise ValueError(f"{entry!r} (keys needed)")
    unknown = [key for key in entry if key not in _KEYS]
    if unknown:
        raise ValueError(f"key '{unknown[0]}' (one of {', '.join(_KEYS)} needed)")
    if "unit_volume_cm3" not in entry:
        raise ValueError("no unit_volume_cm3")
    if entry.get("mesh_measures") is not None and entry.get("size_mm") is None:
        raise ValueError("mesh_measures without size_mm (both needed)")
    volume, std, density = (checked_number(entry.get(key, 0.0), key) for key in (
        "unit_volume_cm3", "unit_volume_std_cm3", "density_g_cm3"))
    mesh, prior, tuned = (folder / str(entry[key]) if entry.get(key) else None
                          for key in _FILE_KEYS)
    counted = entry.get("counted") or []
    if not isinstance(counted, list):
        raise ValueError(f"counted {counted!r} (a list needed)")
    return Part(check_unit_volume(volume * 1e-6), name, std * 1e-6, mesh, density * 1e3,
                checked_friction(entry.get("friction")), prior, tuned,
                str(entry.get("note", "")), tuple(checked_scan(scan) for scan in counted),
                outer_size_m=checked_size(entry.get("size_mm"), volume),
                mesh_measures=checked_measures(entry.get("mesh_measures")),
                piece_weight=checked_piece_weight(entry))
