# SPDX-License-Identifier: Apache-2.0
"""gamma by the network: an ensemble over tiles, its spread, and whether it knows such stacks."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import override

from stack_counter.errors import WeightsError
from stack_counter.files import shipped_weights
from stack_counter.inference import GRAPH, NetworkSession
from stack_counter.occupancy.ensemble import Ensemble, OnnxEnsemble
from stack_counter.occupancy.estimator import OccupancyEstimator
from stack_counter.occupancy.known_form import known_values
from stack_counter.occupancy.maps import (
    StackMaps,
    network_channels,
    picture_maps,
    split_into_tiles,
    stack_maps,
    stack_maps_of_key_view,
)
from stack_counter.occupancy.resolution import measured_resolution
from stack_counter.occupancy.training_domain import TrainingDomain, assess_doubt
from stack_counter.occupancy.weights_file import (
    LastLayerTuning,
    NetworkFile,
    knowing_name,
    read_network_file,
    read_tuning,
    tuned_name,
)
from stack_counter.types import (
    KnownForm,
    KnownLevel,
    OccupancyEstimate,
    Reason,
    StackVolume,
)

if TYPE_CHECKING:
    from stack_counter.pretrained.depth_anything import MonocularDepth

SHIPPED = "gamma.safetensors"
_CALIBRATION = {"scores", "scores_one_side", "centers", "middle", "whiten", "reach"}
# Scores by how the surface was seen: around, from one side, and by pictures without depth. Files
# whose networks were not measured on pictures have none of those, which the first stand in for, as
# the first center does.
_SCORES = ("scores", "scores_one_side", "scores_pictures")


@dataclass(frozen=True)
class NetworkSettings:
    """How estimates are bounded; all chosen.

    Attributes:
        largest_gamma: estimates are cut to it.
        least_parts: V, in parts, below which a stack is empty.
        empty_gamma: gamma of an empty stack, with which any such V counts 0.
        empty_std: standard deviation of that.
        single_view_widening: least factor of the spread of an estimate from one depth image.
    """

    largest_gamma: float = 0.98
    least_parts: float = 0.5
    empty_gamma: float = 0.5
    empty_std: float = 0.25
    single_view_widening: float = 2.0


SETTINGS = NetworkSettings()


@dataclass(frozen=True, eq=False)
class GammaPrediction:
    """What an ensemble predicts for a stack.

    Attributes:
        log_gamma: log of the occupancy ratio.
        relative_std: standard deviation of gamma over gamma.
        shape_logs: (SHAPE_OUTPUTS,) logs of part size, convexity and surface, in part lengths.
    """

    log_gamma: float
    relative_std: float
    shape_logs: np.ndarray


class NetworkEstimator(OccupancyEstimator):
    """The gamma-network with its calibration."""

    def __init__(self, path: Path | None, without_depth: OccupancyEstimator,
                 encoder_folder: Path | None = None, depth_folder: Path | None = None):
        """Loads the network.

        Args:
            path: weights; None is the file shipped with the package.
            without_depth: estimator asked where there is nothing to read.
            encoder_folder: folder of DINOv2, for weights trained upon it.
            depth_folder: folder of Depth Anything, for key views in colour only. What it gives
                has no scale: only networks upon DINOv2 can read it, as in the paper.

        Raises:
            WeightsError: the file is missing, not safetensors, of another format or not whole; or
                Depth Anything is named beside a network that reads heights in part lengths.
        """
        path = path or shipped_weights(SHIPPED)
        file = read_network_file(path)
        calibration = file.calibration
        if set(calibration) - {"scores_pictures"} != _CALIBRATION:
            raise WeightsError(f"{path} has calibration {sorted(calibration)}; expected "
                               f"{sorted(_CALIBRATION)}")
        self._name = f"network {file.facts.get('version', 'unnamed')}"
        self.name = self._name
        self._ensemble, self._members = _load_ensemble(path, file, encoder_folder), file.members
        self._tuning: LastLayerTuning | None = None
        # By level of knowledge; files of networks that know v alone have no such rows.
        self._scores = [np.atleast_2d(calibration.get(name, calibration["scores"]))
                        for name in _SCORES]
        centers = np.atleast_2d(calibration["centers"])
        missing = np.repeat(centers[:, :1], len(_SCORES) - centers.shape[1], axis=1)
        self._centers = np.hstack([centers, missing])  # (levels, ways to see), as the scores
        self._knows_form = bool(file.config.get("knows_form", False))
        rows = min(map(len, [*self._scores, self._centers]))
        if self._knows_form and rows < len(KnownLevel):
            raise WeightsError(f"{path} has scores of {rows} levels of knowledge; expected "
                               f"{len(KnownLevel)}: calibrate it again")
        self._form = KnownForm()
        self._knowing: dict[KnownForm, NetworkEstimator] = {}
        self._domain = TrainingDomain(calibration["middle"], calibration["whiten"],
                                      calibration["reach"])
        self._without_depth = without_depth
        self._monocular: MonocularDepth | None = None
        if depth_folder is not None:
            if file.config.get("encoder") == "own":
                raise WeightsError(f"depth_weights {depth_folder} beside a network that reads "
                                   "heights in part lengths; expected one upon DINOv2")
            # It needs transformers.
            from stack_counter.pretrained.depth_anything import MonocularDepth

            self._monocular = MonocularDepth(depth_folder)

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        level = self._form.level
        seen = 1 if volume.one_side else 2 * (Reason.DEPTH_FROM_PICTURES in volume.reasons)
        scores = self._scores[seen][level]
        empty = OccupancyEstimate(SETTINGS.empty_gamma, SETTINGS.empty_std, scores, self.name)
        if volume.stack_volume < SETTINGS.least_parts * unit_volume:
            return empty  # less than any part takes up, so there is no surface to read
        maps = self._read_maps(volume, unit_volume)
        if maps is None:
            return self._without_depth.estimate(volume, unit_volume)
        if not maps.height.any():
            return empty
        # Predict; take out the median error on families left out.
        prediction = predict_gamma(self._ensemble, maps, known_values(self._form, unit_volume),
                                   measured_resolution(volume, unit_volume), self._tuning)
        center = self._centers[level][seen]
        gamma = min(float(np.exp(prediction.log_gamma + center)), SETTINGS.largest_gamma)
        # Widen the spread where the stack is unlike those of training.
        doubt = assess_doubt(
            maps, parts=gamma * volume.stack_volume / unit_volume,
            part_size=float(np.exp(prediction.shape_logs[0])),
            walled=volume.container.kind not in ("none", "hull"), domain=self._domain)
        reasons, widening = doubt.reasons, doubt.widening
        if volume.top is None:  # read from the key view alone
            reasons += (Reason.SINGLE_VIEW,)
            widening = max(widening, SETTINGS.single_view_widening)
        return OccupancyEstimate(gamma, gamma * prediction.relative_std * widening, scores,
                                 self.name, reasons)

    def last_layer_input(self, volume: StackVolume, unit_volume: float) -> np.ndarray:
        """(members, h) float64: what the last layer of each member reads of a stack.

        Raises:
            ScanError: the surface cannot be read at that size of parts.
            WeightsError: the networks are upon DINOv2, which have no such layer.
        """
        tiles, weights = _network_tiles(stack_maps(volume, unit_volume))
        read = self._ensemble(tiles, known_values(self._form, unit_volume),
                              measured_resolution(volume, unit_volume)).last_layer_input
        if not read.shape[2]:  # of (members, tiles, h)
            raise WeightsError("the network is upon DINOv2; expected one of our own to tune")
        return np.array([weights @ of_member for of_member in read], float)

    @override
    def knowing(self, form: KnownForm) -> NetworkEstimator:
        if not self._knows_form or form == self._form:
            return self
        if form not in self._knowing:
            knowing = copy.copy(self)
            knowing._form, knowing._knowing = form, {}
            knowing.name = knowing_name(self._name, form.level)
            self._knowing = {form: knowing}  # the last one: scans are mostly of the same part
        return self._knowing[form]

    def tuned(self, path: Path) -> NetworkEstimator:
        """Returns the same network with last layers that are adapted to one part.

        Args:
            path: what `checkpoint.save_tuning` has written.

        Raises:
            WeightsError: the file is not such a one, or is of another network.
        """
        tuning = read_tuning(path)
        if tuning.network_name != self.name or tuning.weight.shape[0] != self._members:
            raise WeightsError(f"{path} is tuned from '{tuning.network_name}'; expected "
                               f"'{self.name}'")
        tuned = copy.copy(self)
        tuned.name = tuned_name(self.name, tuning.weight, tuning.bias)
        tuned._tuning, tuned._knowing = tuning, {}
        return tuned

    def _read_maps(self, volume: StackVolume, unit_volume: float) -> StackMaps | None:
        """Maps from the best that there is to read; None if there is nothing.

        Raises:
            ScanError: the surface cannot be read at that size of parts.
        """
        view = volume.key_view
        if volume.top is not None:
            return stack_maps(volume, unit_volume)
        if view is not None and view.depth is not None:
            return stack_maps_of_key_view(volume, unit_volume)
        if view is not None and view.color is not None and self._monocular is not None:
            return picture_maps(view, self._monocular.estimate_nearness(view.color))
        return None


def _load_ensemble(path: Path, file: NetworkFile, encoder_folder: Path | None) -> Ensemble:
    """Returns what runs the networks of a file: ONNX Runtime, or torch where they have no graph.

    Raises:
        WeightsError: the file lacks what its networks need.
    """
    if GRAPH not in file.tensors:
        from stack_counter.occupancy.checkpoint import TorchEnsemble, load_members  # seconds

        return TorchEnsemble(load_members(path, encoder_folder).members)
    return OnnxEnsemble(NetworkSession(path, file.tensors))


def predict_gamma(ensemble: Ensemble, maps: StackMaps, known: np.ndarray, resolution: np.ndarray,
                  tuning: LastLayerTuning | None = None) -> GammaPrediction:
    """Predicts gamma: tiles are weighted by what stands in them, members alike.

    Args:
        ensemble: networks.
        maps: the stack's surface.
        known: (KNOWN_VALUES,) of `known_form.known_values`.
        resolution: (RESOLUTION_VALUES,) of `resolution.resolution_values`.
        tuning: changes of their last layers.
    """
    tiles, weights = _network_tiles(maps)
    output = ensemble(tiles, known, resolution)
    member_log_gamma = output.log_gamma  # (members, tiles)
    if tuning is not None:
        member_log_gamma = member_log_gamma + tuning.bias + np.einsum(
            "mth,mh->mt", output.last_layer_input, tuning.weight)
    # Average the members.
    log_gamma = np.mean(member_log_gamma, axis=0)  # (tiles,)
    scale = np.mean(np.exp(output.log_scale), axis=0)
    shape_logs = np.mean(output.shape_logs, axis=0)
    # Average the tiles; a Laplace distribution's deviation is sqrt(2) of its scale.
    return GammaPrediction(float(np.log(weights @ np.exp(log_gamma))),
                           float(np.sqrt(2) * weights @ scale), weights @ shape_logs)


def _network_tiles(maps: StackMaps) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (n, CHANNELS, TILE, TILE) of tiles that hold something, and their weights (n,)."""
    tiles = [tile for tile in split_into_tiles(maps) if tile.height.any()]
    weights = np.array([tile.height.sum() for tile in tiles], float)
    return np.stack([network_channels(tile) for tile in tiles]), weights / weights.sum()
