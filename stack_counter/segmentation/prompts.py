# SPDX-License-Identifier: Apache-2.0
"""Prompts: what an operator marks in the first view of a scan, and the file that holds it.

A prompts file is YAML or JSON; all numbers are pixels (x right, y down) of the first view as the
camera gave it:

    parts:                        # boxes, points or both
      boxes: [[210, 120, 430, 360]]     # x0, y0, x1, y1: around all parts; usually enough
      points: [[300, 240], [340, 200]]  # on parts; two or three help where colours are alike
    container:                    # optional; without it no pixel is labelled container
      boxes: [[190, 100, 450, 380]]     # around the whole container
    background:                   # optional
      points: [[20, 20]]                # on neither
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stack_counter.config.setting_fields import is_inline
from stack_counter.errors import ConfigError

_SHOWN_LETTERS = 200  # of prompts in a message
_FARTHEST_PX = 1e6  # a number beyond it is no pixel of an image
# Number of coordinates in a mark.
_COORDINATES = {"boxes": 4, "points": 2}
_MARKS = {"parts": ("boxes", "points"), "container": ("boxes", "points"),
          "background": ("points",)}


class PromptError(ConfigError):
    """Prompts are missing, malformed or off the image. The user marks the first view again."""


def _no_marks(coordinates: int) -> Any:
    """Returns a field that holds no marks by default."""
    return field(default_factory=lambda: np.zeros((0, coordinates)))


@dataclass(frozen=True, eq=False)
class Prompts:
    """Marks in the first view, pixels of the full image.

    Raises PromptError if no part is marked.

    Attributes:
        part_boxes, container_boxes: (n, 4) float64: x0, y0, x1, y1; several of one class are one
            area.
        part_points, container_points, background_points: (n, 2) float64: x, y.
    """

    part_boxes: np.ndarray = _no_marks(4)
    part_points: np.ndarray = _no_marks(2)
    container_boxes: np.ndarray = _no_marks(4)
    container_points: np.ndarray = _no_marks(2)
    background_points: np.ndarray = _no_marks(2)

    def __post_init__(self) -> None:
        if not len(self.part_boxes) + len(self.part_points):
            raise PromptError("no part is marked; expected boxes or points under 'parts'")

    @property
    def with_container(self) -> bool:
        """Whether the container is marked."""
        return len(self.container_boxes) + len(self.container_points) > 0

    def scaled(self, scale: np.ndarray) -> Prompts:
        """Returns the same marks in an image resized by these factors (x, y)."""
        # Pixel centres lie on whole numbers.
        return Prompts(*(((marks.reshape(-1, 2) + 0.5) * scale - 0.5).reshape(marks.shape)
                         for marks in self.__dict__.values()))

    def check(self, width: int, height: int) -> None:
        """Refuses prompts that the first view has no pixels for.

        Raises:
            PromptError: a mark lies outside of the image.
        """
        for name, marks in self.__dict__.items():
            for mark in marks:
                pixels = mark.reshape(-1, 2)
                if np.any(pixels < 0) or np.any(pixels > [width, height]):
                    raise PromptError(f"{name} {mark.tolist()} is outside of the {width}x{height} "
                                      "image; expected pixels of the first view")


def parse_prompts(document: Any) -> Prompts:
    """Parses what a file, parameter or service request holds; the module's docstring has the form.

    Raises:
        PromptError: unknown key, wrong type, a box without area, or no part marked.
    """
    if not isinstance(document, dict):
        raise PromptError(f"prompts are {type(document).__name__}; expected 'parts' with boxes or "
                          "points")
    marks: dict[tuple[str, str], np.ndarray] = {}
    for name, body in document.items():
        if name not in _MARKS:
            raise PromptError(f"unknown key '{name}'; expected one of {sorted(_MARKS)}")
        if not isinstance(body, dict):
            raise PromptError(f"'{name}' is {body!r}; expected {' or '.join(_MARKS[name])}")
        for kind, values in body.items():
            if kind not in _MARKS[name]:
                raise PromptError(f"unknown key '{kind}' under '{name}'; expected "
                                  f"{' or '.join(_MARKS[name])}")
            marks[name, kind] = _parse_marks(f"{name}.{kind}", values, _COORDINATES[kind])

    def get(name: str, kind: str) -> np.ndarray:
        return marks.get((name, kind), np.zeros((0, _COORDINATES[kind])))

    return Prompts(get("parts", "boxes"), get("parts", "points"), get("container", "boxes"),
                   get("container", "points"), get("background", "points"))


def read_prompts(source: str) -> Prompts:
    """Reads prompts from a setting: the path of a YAML or JSON file, or its text in braces.

    Raises:
        PromptError: there is no such file, it is not YAML, or holds an unknown key, a wrong type,
            a box without area or no part; the message names the file.
    """
    try:
        text = source if is_inline(source) else Path(source).read_text()
        return parse_prompts(_parse_plain_yaml(text))
    except FileNotFoundError as error:
        raise PromptError(f"no prompts file {source}; expected YAML or JSON") from error
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise PromptError(f"prompts {_shortened(source)} cannot be read as YAML: "
                          f"{str(error).splitlines()[0]}") from error
    except PromptError as error:
        raise PromptError(f"prompts {_shortened(source)}: {error}") from error


def _parse_plain_yaml(text: str) -> Any:
    """Parses YAML without anchors: few letters of those can say billions of marks.

    Raises:
        PromptError: there are anchors.
        yaml.YAMLError: it is not YAML.
        RecursionError: it is nested too deeply.
    """
    if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text, yaml.SafeLoader)):
        raise PromptError("they refer to an anchor (*); expected each mark written out")
    return yaml.safe_load(text)


def _shortened(text: str) -> str:
    """Returns the start of a text, for a message."""
    return text if len(text) <= _SHOWN_LETTERS else f"{text[:_SHOWN_LETTERS]}..."


def _parse_marks(name: str, values: Any, count: int) -> np.ndarray:
    """Returns (n, count) float64 of a list of lists.

    Raises:
        PromptError: it is none, or a box has no area.
    """
    rows = values if isinstance(values, (list, tuple)) else None
    if rows is None or any(not isinstance(row, (list, tuple)) or len(row) != count
                           or not all(_is_number(x) for x in row) for row in rows):
        raise PromptError(f"{name} is {values!r}; expected a list of [{count} numbers]")
    out = np.array(rows, float).reshape(-1, count)
    if count == 4 and np.any(out[:, :2] >= out[:, 2:]):
        raise PromptError(f"{name} is {values!r}; expected x0 < x1 and y0 < y1")
    return out


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) \
        and -_FARTHEST_PX < value < _FARTHEST_PX
