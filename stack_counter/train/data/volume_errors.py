# SPDX-License-Identifier: Apache-2.0
"""One training scene through the reconstruction, compared with its true surface and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.detection import rim_map
from stack_counter.container.inner_surface import outline_area
from stack_counter.container.rim import find_rim
from stack_counter.errors import ScanError, StackCounterError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import VolumeModel, volume_model
from stack_counter.reconstruction import DepthReconstruction, PictureReconstruction
from stack_counter.reconstruction.integral import (
    SETTINGS,
    FillIntegral,
    MeasuredStack,
    StackBoundary,
    volume_std,
)
from stack_counter.sim import RECONSTRUCTED_KIND, DepthCamera, RayCaster, Scene, record
from stack_counter.types import Mesh, View

ARC, ONE_SIDE, PICTURES = "arc", "one side", "pictures"
DEPTH_VIEWS, PICTURE_VIEWS = 12, 24
CREST_CELLS, CREST_M = 5, 0.0005  # a crest is the highest of so many cells, to within metres


@dataclass(frozen=True)
class VolumeErrors:
    """How one scan differs from its scene. Without a part of it, its numbers are NaN.

    Attributes:
        scene: `seed:index`.
        views: how it was recorded: `arc`, `one side` or `pictures`.
        noise_factor: noise of the depth camera relative to the default one.
        depth_noise_m: standard deviation of a depth point as the run time estimates it, m.
        is_heap: the scene has no container.
        true_volume: V of the scene, m3.
        volume: V as measured with the shipped model, m3.
        volume_std: its standard deviation with the shipped model, m3.
        area: area of the cells that hold something, m2.
        hidden_area: share of it that no view saw, m2.
        seen_fill: integral of the fill where a view saw, before the bias is taken out, m3.
        hidden_fill: the same where no view saw, filled in from the neighbours, m3.
        true_hidden_fill: integral of the true fill in the cells of `hidden_fill`, m3.
        bridged: mean of fused less true height where a view saw something held, m.
        crest_worn: mean of true less fused height on the crests of what a view saw, m.
        rim_length: length of the inner rim, m.
        opening_area: area of the opening, m2.
        wall_offset: distance by which the rim opening is found too wide on each side, m.
        assumed_floor: thickness of a floor that no view shows, m; 0 where it was found.
        floor_error: error of that, m.
        lost_rim_width: true less measured width of the rim, m.
    """

    scene: str
    views: str
    noise_factor: float
    depth_noise_m: float
    is_heap: bool
    true_volume: float
    volume: float
    volume_std: float
    area: float = np.nan
    hidden_area: float = np.nan
    seen_fill: float = np.nan
    hidden_fill: float = np.nan
    true_hidden_fill: float = np.nan
    bridged: float = np.nan
    crest_worn: float = np.nan
    rim_length: float = np.nan
    opening_area: float = np.nan
    wall_offset: float = np.nan
    assumed_floor: float = np.nan
    floor_error: float = np.nan
    lost_rim_width: float = np.nan

    def corrected_volume(self, hidden_share: float, worn_height_m: float) -> float:
        """V with another correction of its bias, m3; arguments as in `VolumeModel`."""
        return self.seen_fill + hidden_share * self.hidden_fill + worn_height_m * self.area

    def volume_std_of(self, model: VolumeModel) -> float:
        """Standard deviation of V by the run time's formula with another model, m3."""
        filled_in = (model.hidden_share * self.hidden_fill
                     + model.worn_height_m * self.hidden_area)
        integral = FillIntegral(
            volume=self.corrected_volume(model.hidden_share, model.worn_height_m),
            filled_in=filled_in, area=self.area, fill=np.zeros(0))
        boundary = StackBoundary(self.is_heap, self.rim_length, self.opening_area,
                                 self.assumed_floor)
        return volume_std(integral, boundary, self.depth_noise_m, model)


def measure_volume_errors(scene: Scene, views: str, seed: int, noise_factor: float = 1.0
                          ) -> VolumeErrors:
    """Records a scene with noise, measures V, and compares it with the truth.

    Args:
        scene: with parts.
        views: how it is recorded: `arc`, `one side` or `pictures`.
        seed: of the recording.
        noise_factor: noise of the depth camera relative to the default one.

    Raises:
        StackCounterError: the scan is refused, the container is not found for what it is, or
            stereo measures too little.
    """
    name, unit_volume = f"{scene.seed}:{scene.index}", scene.truth.unit_volume
    if views == PICTURES:
        return _measure_pictures(scene, name, seed)
    # Record and reconstruct, as `stack-counter replay` does.
    taken = record(scene, DEPTH_VIEWS if views == ARC else 1, seed, color=False,
                   camera=_camera(noise_factor))
    if views == ONE_SIDE:
        taken = [replace(view, fixed=True) for view in taken]
    scan = DepthReconstruction(ReconstructorConfig(live=views == ONE_SIDE), unit_volume)
    _add_all(scan, taken)
    volume = scan.measure_volume(taught=None)
    assert scan.stack is not None and scan.region is not None  # measured
    _check_kind(scene, volume.container.kind)
    # Compare heights with the true surface, edges with the true container.
    errors = VolumeErrors(name, views, noise_factor, scan.region.noise,
                          scene.container.kind == "none", scene.truth.stack_volume,
                          volume.stack_volume, volume.stack_volume_std)
    errors = replace(errors, **_height_errors(scene, scan.stack))
    if scene.container.kind == "none":
        return errors
    assert volume.mesh is not None  # of depth views
    return replace(errors, **_edge_errors(scene, scan.stack), lost_rim_width=_lost_rim_width(
        scene, volume.mesh, scan.region, scan.stack.top.pitch))


def _camera(noise_factor: float) -> DepthCamera:
    """The default depth camera with its noise multiplied."""
    camera = DepthCamera()
    return replace(camera, sigma_m=noise_factor * camera.sigma_m,
                   sigma_per_m2=noise_factor * camera.sigma_per_m2)


def _add_all(scan: DepthReconstruction | PictureReconstruction, views: Sequence[View]) -> None:
    """Adds all views.

    Raises:
        ViewError: one of them is refused.
    """
    for view in views:
        scan.add_view(view)


def _check_kind(scene: Scene, found: str) -> None:
    """Refuses a scan whose container was not found for what it is.

    Raises:
        ScanError: with both kinds.
    """
    expected = RECONSTRUCTED_KIND[scene.container.kind]
    if found != expected:
        raise ScanError(f"found container '{found}'; expected '{expected}'")


def _measure_pictures(scene: Scene, name: str, seed: int) -> VolumeErrors:
    """Measures V from colour pictures and true labels alone.

    Raises:
        StackCounterError: the scan is refused, the container is not found for what it is, or
            stereo measures too little.
    """
    scan = PictureReconstruction(ReconstructorConfig(), scene.truth.unit_volume)
    _add_all(scan, [replace(view, depth=None) for view in
                    record(scene, PICTURE_VIEWS, seed, labels=True)])
    volume = scan.measure_volume(taught=None)
    if scan.stereo is None:
        raise ScanError("stereo measures too little; expected depth from pictures")
    _check_kind(scene, volume.container.kind)
    return VolumeErrors(name, PICTURES, np.nan, np.nan, scene.container.kind == "none",
                        scene.truth.stack_volume, volume.stack_volume, volume.stack_volume_std)


def _height_errors(scene: Scene, stack: MeasuredStack) -> dict[str, float]:
    """Integrals of the fused fill and differences to the true heights, as in `VolumeErrors`."""
    # Cast rays down on the true surfaces at the centres of the map's cells.
    footprint = np.isfinite(stack.inner.heights)
    rows, cols = np.mgrid[:footprint.shape[0], :footprint.shape[1]]
    cells = np.stack([(cols + 0.5) * stack.top.pitch, (rows + 0.5) * stack.top.pitch,
                      np.zeros(footprint.shape)], axis=-1)
    xy = geometry.apply(stack.top.T_world_map, cells)[..., :2]
    parts, inside = RayCaster(scene.parts_mesh()).surface_heights(xy), scene.container.inner_mesh()
    below = np.zeros(parts.shape) if inside is None else RayCaster(inside).surface_heights(xy)
    over_opening = np.isfinite(below)
    true_top = np.maximum(parts, below)
    true_fill = np.where(over_opening, true_top - np.where(over_opening, below, 0), 0)
    # Sum up the fused fill where something is held, apart where no view saw.
    fill = np.where(footprint, stack.top.heights.astype(float) - stack.inner.heights, 0)
    holds = fill >= SETTINGS.min_fill_m
    known = stack.seen & ~stack.below
    seen, hidden = holds & known, holds & ~known
    cell_area = stack.boundary.opening_area / max(np.count_nonzero(footprint), 1)
    # Compare heights, and those of the crests alone.
    compared = seen & over_opening
    crests = compared & (true_fill > SETTINGS.min_fill_m) \
        & (true_top > ndimage.maximum_filter(true_top, CREST_CELLS) - CREST_M)
    lower = true_top - stack.top.heights
    return {
        "area": np.count_nonzero(holds) * cell_area,
        "hidden_area": np.count_nonzero(hidden) * cell_area,
        "seen_fill": float(fill[seen].sum()) * cell_area,
        "hidden_fill": float(fill[hidden].sum()) * cell_area,
        "true_hidden_fill": float(true_fill[hidden].sum()) * cell_area,
        "bridged": -float(lower[compared].mean()) if compared.any() else np.nan,
        "crest_worn": float(lower[crests].mean()) if crests.any() else np.nan,
        "rim_length": stack.boundary.rim_length, "opening_area": stack.boundary.opening_area,
        "assumed_floor": stack.boundary.assumed_floor}


def _edge_errors(scene: Scene, stack: MeasuredStack) -> dict[str, float]:
    """Errors of a container's wall and floor, as in `VolumeErrors`."""
    true_area = outline_area(scene.container.opening)
    floor_error = stack.boundary.assumed_floor - scene.container.floor_thickness_m
    return {"wall_offset": (stack.boundary.opening_area - true_area) / stack.boundary.rim_length,
            "floor_error": floor_error if stack.boundary.assumed_floor else np.nan}


def _lost_rim_width(scene: Scene, mesh: Mesh, region: Region, voxel_size: float) -> float:
    """True less measured width of the rim, m; NaN where parts hide its inner edge."""
    rim = find_rim(rim_map(FusedSurface(mesh), region, voxel_size), region.noise_height, "auto")
    return scene.container.wall_thickness_m - rim.width if rim is not None else np.nan


def check_formula(errors: VolumeErrors) -> None:
    """Compares V and its deviation, put together again from the sums, with the run time's.

    Raises:
        StackCounterError: they differ: sums and run time do not mean the same.
    """
    if errors.views != ARC or not errors.volume:
        return
    model = volume_model()
    again = errors.corrected_volume(model.hidden_share, model.worn_height_m)
    std = errors.volume_std_of(model)
    if not np.allclose([again, std], [errors.volume, errors.volume_std], rtol=1e-3):
        raise StackCounterError(f"scene {errors.scene}: V {again} and its deviation {std} m3 from "
                                f"the sums; expected {errors.volume} and {errors.volume_std}")
