# SPDX-License-Identifier: Apache-2.0
"""A count as JSON, as a few lines of text, and as a folder of files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2

from stack_counter import geometry
from stack_counter.display.drawings import draw_container, draw_heights, draw_labels, write_ply
from stack_counter.display.filling_level import filling_level_as_dict
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.result_schema import SCHEMA_VERSION, STAGES
from stack_counter.display.visible_parts import visible_parts_as_dict, visible_text
from stack_counter.types import Container, Reason, StackCount

# Phrases for the sources of gamma; {} is the number of counted scans.
_SOURCE_PHRASES = {"estimator": "it", "piles": "the part's piles", "counted": "counted bins ({})",
                   "training": "other parts"}


def as_dict(count: StackCount, counts: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns the JSON object of `stack-counter replay --json`, as `result_schema` describes it.

    Args:
        count: final count; its `seconds` hold the stages.
        counts: entries as `Replayed.counts`.
    """
    volume, container = count.volume, count.volume.container
    quaternion = geometry.quaternion_from_pose(container.T_world_container)
    return {
        "schema_version": SCHEMA_VERSION,
        "count": count.count, "count_interval": list(count.count_interval),
        "confidence": count.confidence, "gamma": count.gamma, "gamma_std": count.gamma_std,
        "volume_m3": volume.stack_volume, "volume_std_m3": volume.stack_volume_std,
        "unit_volume_m3": count.unit_volume,
        "container": {
            "kind": container.kind, "inner_size_m": list(container.inner_size_m),
            "wall_thickness_m": container.wall_thickness_m,
            "floor_thickness_m": container.floor_thickness_m,
            "pose": {"position_m": container.T_world_container[:3, 3].tolist(),
                     "quaternion_xyzw": quaternion.tolist()}},
        "views": {"received": volume.views.received, "used": volume.views.used,
                  "skipped": volume.views.skipped},
        "view_agreement_mm": 1000 * volume.view_agreement_m,
        "coverage": volume.coverage, "fill_level": list(volume.fill_level),
        "overfilled": volume.overfilled, **filling_level_as_dict(volume.filling_level),
        "estimator": count.estimator, "gamma_shares": count.gamma_shares,
        "counted_scans": count.counted_scans,
        "count_sources": [{"source": s.source, "count": s.count, "share": s.share,
                           "count_interval": list(s.count_interval)} for s in count.sources],
        "net_weight_kg": count.net_weight_kg, **visible_parts_as_dict(count.visible_parts),
        "status": count.status, "reasons": list(count.reasons),
        "counts": counts,
        "seconds": {stage: count.seconds.get(stage, 0.0) for stage in STAGES},
    }


def as_text(count: StackCount, true_count: int | None) -> str:
    """Returns the lines that a person reads: the figures, and a sentence for each reason.

    Args:
        count: final count.
        true_count: number of parts that are really there; None where nobody knows.
    """
    volume, (low, high) = count.volume, count.count_interval
    # The count.
    lines = [f"count      {count.count} parts, {count.confidence:.0%} sure between {low} and "
             f"{high}"]
    if true_count is not None:
        error = f" (error {(count.count - true_count) / true_count:+.1%})" if true_count else ""
        lines.append(f"true count {true_count}{error}")
    if count.visible_parts is not None:
        lines.append(f"visible    {visible_text(count)}")
    # What it was computed from.
    if len(count.sources) > 1:
        lines.append(f"sources    {sources_text(count)}")
    lines += [
        f"V          {volume.stack_volume * 1e6:.1f} cm3 +- {volume.stack_volume_std * 1e6:.1f}",
        f"gamma      {count.gamma:.3f} +- {count.gamma_std:.3f}, said by {count.estimator}"
        + _gamma_weights_text(count),
        f"v          {count.unit_volume * 1e6:.4f} cm3",
        f"container  {container_text(volume.container)}",
        f"views      {volume.views.used} used of {volume.views.received}"
        + (f", skipped {volume.views.skipped}" if volume.views.skipped else "")
        + (f", {1000 * volume.view_agreement_m:.1f} mm apart" if volume.view_agreement_m else ""),
        "seconds    " + ", ".join(f"{stage} {count.seconds[stage]:.2f}" for stage in STAGES
                                  if stage in count.seconds)]
    # What qualifies it.
    slugs = f" ({', '.join(count.reasons)})" if count.reasons else ""
    return "\n".join([*lines, f"status     {count.status}{slugs}", *reason_lines(count.reasons)])


def sources_text(count: StackCount) -> str:
    """Returns what each source alone counts, and how much it weighs."""
    return ", ".join(f"by {s.source} {s.count} ({s.count_interval[0]} to {s.count_interval[1]}, "
                     f"weighs {s.share:.1%})" for s in count.sources)


def reason_lines(reasons: Sequence[Reason]) -> list[str]:
    """Returns one line for each reason: its slug, what was seen, and what to do about it."""
    return [f"  {reason}: {reason.sentence}" for reason in reasons]


def _gamma_weights_text(count: StackCount) -> str:
    """Returns how much each source of gamma weighs; empty for one source alone."""
    if len(count.gamma_shares) < 2:
        return ""
    return " (weights: " + ", ".join(
        f"{_SOURCE_PHRASES[name].format(count.counted_scans)} {share:.0%}"
        for name, share in count.gamma_shares.items()) + ")"


def container_text(container: Container) -> str:
    """Returns the kind of a container, and its sizes in millimetres where they were measured."""
    if not any(container.inner_size_m):
        return container.kind
    size = " x ".join(f"{1000 * s:.0f}" for s in container.inner_size_m)
    return f"{container.kind}, {size} mm inside, wall {1000 * container.wall_thickness_m:.1f} mm"


def write_report(folder: Path, count: StackCount, counts: list[dict[str, Any]],
                 subject: ReportSubject = ReportSubject()) -> None:
    """Writes the page, result.json, the model, and pictures as files.

    Args:
        folder: made where it does not exist; files of the same names are replaced.
        count: final count.
        counts: as for `as_dict`.
        subject: what the count is of.

    Raises:
        OSError: the folder cannot be written.
    """
    from stack_counter.display.page.report_files import write_page  # no node waits for it

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(as_dict(count, counts), indent=2) + "\n")
    beside = ["result.json"]
    volume = count.volume
    pictures = {}
    if volume.top is not None:
        pictures["top_surface.png"] = draw_heights(volume.top)
    if volume.key_view is not None and volume.key_view.color is not None:
        pictures["key_view.png"] = draw_labels(volume.key_view)
    if volume.key_view is not None and volume.container.rings is not None:
        pictures["container.png"] = draw_container(volume.key_view, volume.container)
    for name, picture in pictures.items():
        if not cv2.imwrite(str(folder / name), picture):
            raise OSError(f"cannot write {folder / name}")
        beside.append(name)
    if volume.mesh is not None and len(volume.mesh.vertices):
        write_ply(folder / "surface.ply", volume.mesh)
        beside.append("surface.ply")
    write_page(folder, count, subject, beside)
