"""A count as JSON, as a few lines of text, and as pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.display.mesh_colors import display_colors
from stack_counter.types import CONTAINER, PARTS, Container, HeightMap, KeyView, Mesh, StackCount

STAGES = ("load", "read", "segment", "integrate", "finish", "gamma", "total")
_SOURCES = {"estimator": "it", "piles": "the part's piles", "counted": "counted bins ({})",
            "training": "other parts"}
_SHOWN = 640  # width of the pictures, pixels


def as_dict(count: StackCount, counts: list[dict[str, Any]]) -> dict[str, Any]:
    """The JSON object of `stack-counter replay --json`.

    Args:
        count: final count; its `seconds` hold the stages.
        counts: `{stamp_ns, count, count_interval}` for each view, in continuous mode.
    """
    volume, box = count.volume, count.volume.container
    x, y, z, w = geometry.quaternion_from_pose(box.T_world_container)
    return {
        "count": count.count, "count_interval": list(count.count_interval),
        "confidence": count.confidence, "gamma": count.gamma, "gamma_std": count.gamma_std,
        "volume_m3": volume.stack_volume, "volume_std_m3": volume.stack_volume_std,
        "unit_volume_m3": count.unit_volume,
        "container": {
            "kind": box.kind, "inner_size_m": list(box.inner_size_m),
            "wall_thickness_m": box.wall_thickness_m,
            "floor_thickness_m": box.floor_thickness_m,
            "pose": {"position_m": box.T_world_container[:3, 3].tolist(),
                     "quaternion_xyzw": [float(q) for q in (x, y, z, w)]}},
        "views": {"received": volume.views.received, "used": volume.views.used,
                  "skipped": volume.views.skipped},
        "coverage": volume.coverage, "fill_level": list(volume.fill_level),
        "estimator": count.estimator, "gamma_shares": count.gamma_shares,
        "counted_scans": count.counted_scans,
        "status": count.status, "reasons": list(count.reasons),
        "counts": counts,
        "seconds": {stage: count.seconds.get(stage, 0.0) for stage in STAGES},
    }


def as_text(count: StackCount, true_count: int | None) -> str:
    """The lines a person reads."""
    volume, (low, high) = count.volume, count.count_interval
    lines = [f"count      {count.count} parts, {count.confidence:.0%} sure between {low} and "
             f"{high}"]
    if true_count is not None:
        error = f" (error {(count.count - true_count) / true_count:+.1%})" if true_count else ""
        lines.append(f"true count {true_count}{error}")
    box = volume.container
    size = " x ".join(f"{1000 * s:.0f}" for s in box.inner_size_m)
    known = "" if len(count.gamma_shares) < 2 else " (weights: " + ", ".join(
        f"{_SOURCES[name].format(count.counted_scans)} {share:.0%}"
        for name, share in count.gamma_shares.items()) + ")"
    lines += [
        f"V          {volume.stack_volume * 1e6:.1f} cm3 +- {volume.stack_volume_std * 1e6:.1f}",
        f"gamma      {count.gamma:.3f} +- {count.gamma_std:.3f}, said by {count.estimator}{known}",
        f"v          {count.unit_volume * 1e6:.4f} cm3",
        f"container  {box.kind}" + (f", {size} mm inside, wall "
                                    f"{1000 * box.wall_thickness_m:.1f} mm"
                                    if any(box.inner_size_m) else ""),
        f"views      {volume.views.used} used of {volume.views.received}"
        + (f", skipped {volume.views.skipped}" if volume.views.skipped else ""),
        "seconds    " + ", ".join(f"{stage} {count.seconds[stage]:.2f}" for stage in STAGES
                                  if stage in count.seconds),
        f"status     {count.status}" + (f" ({', '.join(count.reasons)})" if count.reasons else ""),
    ]
    return "\n".join(lines)


def write_report(folder: Path, count: StackCount, counts: list[dict[str, Any]]) -> None:
    """Writes result.json, the top surface, the labelled key view and the carved surface.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(as_dict(count, counts), indent=2) + "\n")
    volume = count.volume
    pictures = {}
    if volume.top is not None:
        pictures["top_surface.png"] = draw_heights(volume.top)
    if volume.key_view is not None and volume.key_view.color is not None:
        pictures["key_view.png"] = draw_labels(volume.key_view)
    if volume.key_view is not None and volume.container.rings is not None:
        pictures["container.png"] = draw_container(volume.key_view, volume.container)
    if volume.mesh is not None and len(volume.mesh.vertices):
        pictures["surface.png"] = draw_points(volume.mesh)
        write_ply(folder / "surface.ply", volume.mesh)
    for name, picture in pictures.items():
        if not cv2.imwrite(str(folder / name), picture):
            raise OSError(f"cannot write {folder / name}")


def draw_heights(top: HeightMap) -> np.ndarray:
    """(h, w, 3) uint8 BGR: low is dark, high is bright, not seen is grey."""
    heights = top.heights[::-1]  # y of the map upwards
    seen = np.isfinite(heights)
    low, high = np.nanpercentile(heights, [0, 100]) if seen.any() else (0.0, 1.0)
    scaled = np.nan_to_num((heights - low) / max(high - low, 1e-9))
    picture = cv2.applyColorMap((255 * scaled).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    picture[~seen] = 128
    factor = max(round(_SHOWN / picture.shape[1]), 1)
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)


def draw_labels(view: KeyView) -> np.ndarray:
    """(h, w, 3) uint8 BGR: the picture with parts tinted green and the container orange."""
    assert view.color is not None  # the caller has looked
    picture = view.color[..., ::-1].astype(np.float32)
    for label, tint in ((PARTS, (60, 200, 60)), (CONTAINER, (0, 140, 255))):
        picture[view.labels == label] = 0.6 * picture[view.labels == label] + 0.4 * np.array(tint)
    return picture.astype(np.uint8)


def draw_container(view: KeyView, container: Container) -> np.ndarray:
    """(h, w, 3) uint8 BGR: the key view with the fitted inner wall: rim red, floor blue, and
    lines between them."""
    assert container.rings is not None  # the caller has looked
    if view.color is not None:
        picture = np.ascontiguousarray(view.color[..., ::-1])
    else:
        picture = cv2.cvtColor(((view.labels % 3) * 100).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(picture, None, fx=2, fy=2)
    rings = container.rings
    above = rings[rings[:, 0, 2] >= container.floor_thickness_m]
    local = geometry.apply(geometry.inverse(view.T_world_camera) @ container.T_world_container,
                           above)
    pixels, _ = geometry.project(local, view.intrinsics)
    lines = np.round(2 * pixels + 0.5).astype(np.int32)  # (k, n, 2)
    for i in range(0, lines.shape[1], max(lines.shape[1] // 12, 1)):
        down = np.ascontiguousarray(lines[:, i])
        cv2.polylines(picture, [down], False, (0, 200, 255), 1, cv2.LINE_AA)
    for ring, color in ((lines[0], (255, 80, 0)), (lines[-1], (0, 0, 255))):
        cv2.polylines(picture, [ring], True, color, 1, cv2.LINE_AA)
    return picture


def write_ply(path: Path, mesh: Mesh) -> None:
    """Writes a mesh as a binary PLY file, with colours where it has them.

    Raises:
        OSError: the file cannot be written.
    """
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    names = ["property float x", "property float y", "property float z"]
    if mesh.colors is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    vertices = np.zeros(len(mesh.vertices), fields)
    for i, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, i]
    if mesh.colors is not None:
        for i, name in enumerate(("red", "green", "blue")):
            vertices[name] = mesh.colors[:, i]
    faces = np.zeros(len(mesh.triangles), [("n", "u1"), ("index", "<i4", 3)])
    faces["n"], faces["index"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *names,
              f"element face {len(faces)}", "property list uchar int vertex_indices",
              "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def draw_points(mesh: Mesh) -> np.ndarray:
    """(h, w, 3) uint8 BGR: a mesh's vertices seen obliquely from above, in their own colours or
    coloured by height."""
    points = mesh.vertices
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    T = geometry.look_at(middle + size * np.array([1.0, -1.4, 1.4]), middle)
    local = geometry.apply(geometry.inverse(T), points.astype(float))
    focal = 1.4 * _SHOWN
    pixels = np.round(local[:, :2] / local[:, 2:] * focal + _SHOWN / 2).astype(int)
    far_first = np.argsort(-local[:, 2])
    colors = display_colors(mesh)[:, ::-1]
    picture = np.full((_SHOWN, _SHOWN, 3), 255, np.uint8)
    for dx in range(2):
        for dy in range(2):
            x, y = pixels[far_first, 0] + dx, pixels[far_first, 1] + dy
            inside = (x >= 0) & (x < _SHOWN) & (y >= 0) & (y < _SHOWN)
            picture[y[inside], x[inside]] = colors[far_first][inside]
    return picture
