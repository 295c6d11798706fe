# SPDX-License-Identifier: Apache-2.0
"""What each baseline sees, what it learnt from, and which files of the user's it needs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BaselineKind:
    """One row of the paper's tables.

    Attributes:
        title: the paper's name of it.
        sees: what it gets of a scene.
        learnt_from: what its weights were trained on.
        needs: the user's files and folders, in order.
        fewest_paths: how many of them it cannot do without.
        gives: `count` of parts, or `gamma`, which is multiplied with V / v.
    """

    title: str
    sees: str
    learnt_from: str
    needs: tuple[str, ...]
    fewest_paths: int = 1
    gives: str = "count"


_NET = "a file of train.pictures"
_ENCODER = "a folder with DINOv2 or ViT, if it was trained upon it"
_RENDERED = "rendered key views with the number of all parts"

# By the name that commands take.
KINDS = {
    "vit_h": BaselineKind("ViT+H", "colour of the key view", _RENDERED, (_NET, _ENCODER)),
    "bmnet": BaselineKind(
        "BMNet+", "colour of the key view, boxes around three parts that show",
        "rendered key views with the places of the visible parts, or FSC-147 (the user's file)",
        (_NET,)),
    "sam_clip": BaselineKind(
        "SAM+CLIP", "colour of the key view, the part's name", "foreign: SA-V, pictures with text",
        ("a folder with SAM 2", "a folder with CLIP"), fewest_paths=2),
    "vlm": BaselineKind(
        "vision-language model", "colour of the key view, the part's name", "foreign",
        ("a folder with an image-text model",)),
    "human": BaselineKind("Human", "what people were shown", "nothing",
                          ("a YAML or JSON file of scenes with guesses",)),
    "color": BaselineKind("Ours (Color)", "colour of the key view; V and v as ours has them",
                          "rendered key views with gamma", (_NET, _ENCODER), gives="gamma"),
}
