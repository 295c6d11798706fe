# SPDX-License-Identifier: Apache-2.0
"""The nouns of the package as frozen dataclasses: SI units, optical camera frames, z-up world."""

from stack_counter.types.arrangement import Arrangement
from stack_counter.types.filling_level import CellFillingLevel, FillingLevel, RangeValue
from stack_counter.types.part_form import KnownForm, KnownLevel, MeshMeasures
from stack_counter.types.part_request import PartRequest
from stack_counter.types.reasons import Reason
from stack_counter.types.results import (
    OccupancyEstimate,
    SourceCount,
    StackCount,
    StackVolume,
)
from stack_counter.types.shapes import (
    CONTAINER_KINDS,
    Container,
    HeightMap,
    InnerMap,
    Mesh,
    WallShape,
)
from stack_counter.types.views import (
    BACKGROUND,
    CONTAINER,
    PARTS,
    UNLABELLED,
    UNSEEN,
    Intrinsics,
    KeyView,
    View,
    ViewTally,
    spread_views,
)
from stack_counter.types.visible_parts import PartPose, VisiblePart

__all__ = [
    "Arrangement",
    "BACKGROUND",
    "CONTAINER",
    "CONTAINER_KINDS",
    "CellFillingLevel",
    "Container",
    "FillingLevel",
    "HeightMap",
    "InnerMap",
    "Intrinsics",
    "KeyView",
    "KnownForm",
    "KnownLevel",
    "Mesh",
    "MeshMeasures",
    "OccupancyEstimate",
    "PARTS",
    "PartPose",
    "PartRequest",
    "RangeValue",
    "Reason",
    "SourceCount",
    "StackCount",
    "StackVolume",
    "UNLABELLED",
    "UNSEEN",
    "View",
    "ViewTally",
    "VisiblePart",
    "WallShape",
    "spread_views",
]
