# SPDX-License-Identifier: Apache-2.0
"""The paper's baselines "Human" and "Human-Vote": guesses that people have made.

A YAML or JSON file gives one guess or a list of them for each scene:

    pasta: [200, 230, 500]
    bricks: 80
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stack_counter.errors import ConfigError
from stack_counter.picture_baselines.picture import Picture


class People:
    """Looks guesses up."""

    def __init__(self, path: Path):
        """Reads the guesses.

        Raises:
            ConfigError: the file is missing, not YAML, or holds anything but numbers by scene.
        """
        try:
            document = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise ConfigError(f"{path} cannot be read: {' '.join(str(error).split())}; expected "
                              "a YAML or JSON file of scenes with guesses") from error
        if not isinstance(document, dict):
            raise ConfigError(f"{path} holds a {type(document).__name__}; expected scenes with "
                              "guesses")
        self._guesses = {str(scene): _read_guesses(path, scene, value)
                         for scene, value in document.items()}

    def guess(self, picture: Picture) -> list[float]:
        """Gives the guesses for the picture's scene; none if nobody was asked."""
        return self.guesses_for(picture.scene)

    def guesses_for(self, scene: str) -> list[float]:
        """Gives the guesses for a scene by its name; none if nobody was asked."""
        return self._guesses.get(scene, [])


def _read_guesses(path: Path, scene: object, value: object) -> list[float]:
    """The guesses of one scene as a list.

    Raises:
        ConfigError: one is no number above 0.
    """
    guesses: list[Any] = value if isinstance(value, list) else [value]
    for guess in guesses:
        if isinstance(guess, bool) or not isinstance(guess, (int, float)) \
                or not (np.isfinite(guess) and guess > 0):
            raise ConfigError(f"{path}: scene {scene} has the guess {guess!r}; expected numbers "
                              "above 0")
    return [float(guess) for guess in guesses]
