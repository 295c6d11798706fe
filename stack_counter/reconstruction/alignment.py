# SPDX-License-Identifier: Apache-2.0
"""Makes the views of a scan agree: registers them where poses are off, leaves out what is wrong.

Views that agree to a voxel, as those of a good arm do, are taken as they were fused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.depth_fusion import DepthFusion
from stack_counter.fusion.leveling import lift_to_support
from stack_counter.fusion.region import Region, find_region, find_region_again
from stack_counter.fusion.registration import SETTINGS as REGISTRATION
from stack_counter.fusion.registration import register_views
from stack_counter.fusion.view_shift import measure_agreement
from stack_counter.reconstruction.view_agreement import (
    agree_throughout,
    check_agreement,
    count_contradicting,
    name_view,
    views_to_leave_out_first,
)
from stack_counter.reconstruction.view_pairs import ViewPair, compare_views
from stack_counter.types import View


@dataclass(frozen=True)
class AlignmentSettings:
    """From when on views are registered, flagged or refused.

    Attributes:
        apart_voxels: shift between views from which on they are registered, voxels. Chosen:
            poses off by 0.5 mm and 0.05 degrees leave 0.4 to 0.7 on training scenes.
        refused_voxels: shift from which on a registered scan is refused, voxels; chosen.
    """

    apart_voxels: float = 1.0
    refused_voxels: float = 2.5


SETTINGS = AlignmentSettings()


@dataclass(frozen=True, eq=False)
class AlignedScan:
    """The views that are measured, and the surface that they give.

    Attributes:
        fusion: of these views.
        views: cropped to the region, with corrected poses; a new list.
        agreement_m: median shift between successive views, m; 0 if not known.
        agree: that is below a voxel, and no view or group of views lies far from the others.
        left_out: errors of the views that contradict the others.
    """

    fusion: DepthFusion
    views: list[View]
    agreement_m: float = 0.0
    agree: bool = True
    left_out: tuple[ViewError, ...] = ()


def align_scan(fusion: DepthFusion, views: list[View], config: ReconstructorConfig,
               unit_volume: float) -> AlignedScan:
    """Registers the views of a scan if need be, and leaves out those that contradict the others.

    Args:
        fusion: of the views as they came.
        views: as `fusion` has returned them.
        config: of the scan; in live mode views differ as parts are taken, and are left alone.
        unit_volume: volume of one part, m3; 0 where it is not known.

    Raises:
        ScanError: the views contradict each other, or cannot be brought together.
    """
    if config.live or len(views) < 2:
        return AlignedScan(fusion, list(views))
    apart, refused = (voxels * fusion.voxel_size for voxels in
                      (SETTINGS.apart_voxels, SETTINGS.refused_voxels))
    # Leave out what most others contradict, before it pulls them along.
    pairs = compare_views(views, fusion.region)
    off = views_to_leave_out_first(pairs, len(views), config.min_views)
    kept, region = _leave_out(views, off, fusion.region, config)
    if off:
        pairs = compare_views(kept, region)
    # Register the others where they lie apart.
    agreement = measure_agreement(kept, region)
    if agreement.median_m > apart or not agree_throughout(pairs, len(kept)):
        kept, region, pairs = _bring_together(kept, region, pairs, config,
                                              agreement.median_m, apart)
    # Leave out what contradicts them still.
    still_off = check_agreement(kept, pairs, config.min_views)
    errors = tuple(ViewError("contradicts_others", f"{name} contradicts the views beside it; "
                             "expected the same surface")
                   for name in (*(name_view(views[i], i) for i in off),
                                *(name_view(kept[i], i) for i in still_off)))
    kept, region = _leave_out(kept, still_off, region, config)
    # Fuse them again.
    if kept is not views:
        fusion = DepthFusion(region, config, unit_volume)
        kept = [fusion.integrate(view, is_smooth=True) for view in kept]
        agreement = measure_agreement(kept, region)
    _refuse_apart(agreement.median_m, refused)
    return AlignedScan(fusion, list(kept), agreement.median_m, agreement.some_m <= apart, errors)


def _leave_out(views: list[View], off: list[int], region: Region, config: ReconstructorConfig
               ) -> tuple[list[View], Region]:
    """The views but for some, and the region around what these show standing.

    Args:
        views: with depth.
        off: indices of those to leave out; none returns what was given.
        region: as found with all of them; a configured one stays as it is.
        config: of the scan.
    """
    if not off:
        return views, region
    kept = [view for i, view in enumerate(views) if i not in off]
    if region.configured:
        return kept, region
    return kept, replace(find_region(kept, config), noise=region.noise)


def _bring_together(views: list[View], region: Region, pairs: list[ViewPair],
                    config: ReconstructorConfig, apart_m: float, limit_m: float
                    ) -> tuple[list[View], Region, list[ViewPair]]:
    """Registers views, and finds the region again, which poses that are off blow up.

    Args:
        views: with depth.
        region: as found before.
        pairs: of the views as they are.
        config: a configured region stays as it is.
        apart_m: how far successive views seem apart, m.
        limit_m: how far they may be apart.

    Returns:
        The views with corrected poses, the region around what they show standing, and their
        pairs; all as they were where more of the views contradict each other then, as where one
        of several like things was set on the next, or as many and they had not been apart, as
        where something came into sight.
    """
    registered, around = views, region
    for levels in (REGISTRATION.coarse, REGISTRATION.fine):
        registered = register_views(registered, around, levels, max(apart_m, limit_m))
        registered = lift_to_support(registered, around)
        if not any(config.roi_size_m):
            around = find_region_again(registered, around)
    new_pairs = compare_views(registered, around)
    more = count_contradicting(new_pairs) - count_contradicting(pairs)
    if more > 0 or (more == 0 and apart_m <= limit_m):
        return views, region, pairs
    return registered, around, new_pairs


def _refuse_apart(agreement: float, limit: float) -> None:
    """Refuses a scan whose views lie farther apart than `limit`, both in metres.

    Raises:
        ScanError: they do.
    """
    if agreement > limit:
        raise ScanError(
            f"the views disagree by {1000 * agreement:.1f} mm and could not be brought together; "
            f"expected below {1000 * limit:.1f} mm: calibrate the camera on the arm (hand-eye), "
            "check that images and poses have one clock, and that nothing moves during a scan")
