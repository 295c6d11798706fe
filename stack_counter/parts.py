"""The part catalogue: names and unit volumes (config/parts.yaml)."""

from __future__ import annotations

from pathlib import Path

import yaml

from stack_counter.counting import check_unit_volume
from stack_counter.errors import ConfigError, PartError
from stack_counter.resources import config_path


def load_parts(path: Path | None = None) -> dict[str, float]:
    """Unit volumes in m3 by part name; None is the shipped catalogue.

    Raises:
        ConfigError: the catalogue is missing or malformed.
    """
    path = path or config_path("parts.yaml")
    try:
        document = yaml.safe_load(path.read_text())
        return {str(name): float(entry["unit_volume_cm3"]) * 1e-6
                for name, entry in (document.get("parts") or {}).items()}
    except OSError as error:
        raise ConfigError(f"no part catalogue {path}: {error.strerror}") from error
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path} is malformed at {error}; expected 'parts: NAME: "
                          "unit_volume_cm3: NUMBER'") from error


def resolve_unit_volume(part: str, unit_volume: float) -> float:
    """The unit volume in m3: as given, else that of the named part.

    Args:
        part: name in the catalogue, or "".
        unit_volume: m3; 0 where not given.

    Raises:
        PartError: neither is given, the name is unknown, or the volume is no positive number.
    """
    if unit_volume != 0:
        return check_unit_volume(unit_volume)
    if not part:
        raise PartError("no part named and no unit volume given; expected one of them")
    parts = load_parts()
    if part not in parts:
        raise PartError(f"unknown part '{part}'; expected one of {sorted(parts)}")
    return check_unit_volume(parts[part])
