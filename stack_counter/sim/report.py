# SPDX-License-Identifier: Apache-2.0
"""One page with pictures that shows what a folder of simulated scenes holds."""

from __future__ import annotations

import base64
import html
import json
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.dataset import LOG_FILE
from stack_counter.sim.report_plots import LARGEST_SHARE, Columns, draw_plots
from stack_counter.sim.scenes.containers import KINDS
from stack_counter.sim.scenes.scene import Scene
from stack_counter.sim.scenes.shards import read_failed_tries, read_shard, shard_paths
from stack_counter.sim.shapes import FAMILIES
from stack_counter.types import Intrinsics

PAGE = "report.html"
# Pictures of scenes: how many, by which camera, tilted how far from the vertical, with how much
# room around the scene.
_PICTURES, _TILT, _MARGIN = 24, np.deg2rad(40), 1.1
_CAMERA = Intrinsics(240, 180, 230.0, 230.0, 119.5, 89.5)
_STYLE = """body{font:15px sans-serif;margin:2em;max-width:1240px}
td,th{text-align:left;vertical-align:top;padding:3px 14px 3px 0;border-bottom:1px solid #ddd}
figure{display:inline-block;margin:4px}figcaption{font-size:12px;max-width:240px}
img{max-width:100%}"""


def write_report(folder: Path, out: Path | None = None) -> Path:
    """Writes the statistics of all scenes in a folder as one page that needs no other file.

    Args:
        folder: holds `shard_*.npz`, and `simulate.log` if the rate is to be stated.
        out: the page; `report.html` in the folder by default.

    Returns:
        Where the page is.

    Raises:
        SceneError: no shard there, or a damaged one.
    """
    paths = shard_paths(folder)
    columns = _read_columns(paths)
    rows = _table_rows(columns, paths) + _rate_rows(folder / LOG_FILE)
    table = "".join(f"<tr><th>{name}</th><td>{html.escape(text)}</td></tr>" for name, text in rows)
    plots = "".join(f"<p>{_image_tag(png, title)}</p>" for title, png in draw_plots(columns))
    page = (f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>Simulated scenes"
            f"</title><style>{_STYLE}</style></head><body><h1>Simulated scenes</h1>"
            f"<p>{html.escape(str(folder.resolve()))}</p><table>{table}</table>{plots}"
            f"<h2>Scenes spread over the set</h2>{_contact_sheet(columns, paths)}</body></html>")
    out = out or folder / PAGE
    out.write_text(page, encoding="utf-8")
    return out


def _read_columns(paths: list[Path]) -> Columns:
    """What the page needs of every scene; the measures of a part are taken once."""
    complexity: dict[tuple[str, int], float] = {}
    rows = []
    for number, path in enumerate(paths):
        for position, scene in enumerate(read_shard(path)):
            shape = scene.shape
            part = (shape.family, shape.seed)
            if part not in complexity:
                complexity[part] = shape.complexity
            rows.append({"shard": number, "position": position, "complexity": complexity[part],
                         **_scene_values(scene)})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _scene_values(scene: Scene) -> dict[str, Any]:
    """The values of one scene by column.

    Width and depth in part sizes, and the wall as a share of the width, are NaN for a heap.
    """
    container, truth = scene.container, scene.truth
    width, depth = (np.nan, np.nan) if container.kind == "none" \
        else (min(container.inner_size_m[:2]), container.inner_size_m[2])
    return {"family": scene.shape.family, "seed": scene.shape.seed, "kind": container.kind,
            "width": width / scene.shape.part_size, "depth": depth / scene.shape.part_size,
            "wall": container.wall_thickness_m / width,
            "count": truth.count, "gamma": truth.gamma, "fill": truth.fill,
            "gamma_whole": truth.gamma_whole, "gamma_center": truth.gamma_center}


def _table_rows(columns: Columns, paths: list[Path]) -> list[tuple[str, str]]:
    """Rows of the page's table: name and text."""
    count, gamma = columns["count"], columns["gamma"][np.isfinite(columns["gamma"])]
    parts, families = int(count.sum()), Counter(columns["family"].tolist())
    distinct = set(zip(columns["family"].tolist(), columns["seed"].tolist()))
    file_bytes = sum(path.stat().st_size for path in paths)
    spread = np.percentile(gamma, (0, 5, 50, 95, 100)) if len(gamma) else [np.nan] * 5
    kinds = ", ".join(f"{kind} {np.mean(columns['kind'] == kind):.1%}" for kind in KINDS)
    family, scenes = families.most_common(1)[0]
    failed: Counter[str] = sum(map(read_failed_tries, paths), Counter())
    reasons = ", ".join(f"{reason} {n}" for reason, n in failed.most_common())
    missing = ", ".join(sorted(set(FAMILIES) - set(families)))
    return [
        ("Scenes", f"{len(count):,} in {len(paths):,} shards"),
        ("Distinct parts", f"{len(distinct):,}"),
        ("Families", f"{len(families)}; largest share {scenes / len(count):.1%} ({family}), "
                     f"at most {LARGEST_SHARE:.0%}"),
        ("Training families without a scene", missing or "none"),
        ("Parts in total", f"{parts:,}"),
        ("Count", f"mean {count.mean():.1f}, min {count.min()}, median {np.median(count):.0f}, "
                  f"max {count.max()}"),
        ("gamma", "min {:.3f}, 5% {:.3f}, median {:.3f}, 95% {:.3f}, max {:.3f}".format(*spread)),
        ("Scenes with gamma above 1", f"{np.sum(gamma > 1)}; empty {len(count) - len(gamma)}"),
        ("Containers", kinds),
        ("Failed tries", f"{failed.total()} ({failed.total() / len(count):.1%} of the scenes): "
                         f"{reasons or 'none'}"),
        ("On disk", f"{file_bytes / 1e6:.2f} MB, {file_bytes / max(parts, 1):.1f} bytes a part"),
    ]


def _rate_rows(log: Path) -> list[tuple[str, str]]:
    """The row with the speed that the log states; a last line without its end is being written."""
    lines = log.read_text().rpartition("\n")[0].splitlines() if log.exists() else []
    if not lines:
        return []
    shards = [json.loads(line) for line in lines]
    seconds, scenes, parts = (sum(s[n] for s in shards) for n in ("seconds", "scenes", "parts"))
    workers = len({s["worker"] for s in shards})
    return [("Rate of one worker", f"{3600 * scenes / seconds:,.0f} scenes/h, "
             f"{parts / seconds:,.0f} parts/s; {len(shards)} shards by {workers} workers in "
             f"{seconds / 3600:.2f} h of their time")]


def _contact_sheet(columns: Columns, paths: list[Path]) -> str:
    """HTML with a picture of each of 24 scenes, or of all if there are fewer."""
    last, figures = len(columns["count"]) - 1, []
    for i in np.unique(np.linspace(0, last, _PICTURES).astype(int)):
        scene = read_shard(paths[columns["shard"][i]])[columns["position"][i]]
        png = cv2.imencode(".png", _render_overview(scene)[..., ::-1])[1].tobytes()
        text = f"{scene.index}: {scene.shape.family}, {scene.container.kind}, " \
               f"{scene.truth.count} parts, gamma {scene.truth.gamma:.3f}"
        figures.append(f"<figure>{_image_tag(png, text)}<figcaption>{html.escape(text)}"
                       "</figcaption></figure>")
    return "".join(figures)


def _render_overview(scene: Scene) -> np.ndarray:
    """(180, 240, 3) uint8 RGB of the whole scene, seen obliquely."""
    low, high = scene.bounds()
    distance = np.linalg.norm(high - low) / 2 * _MARGIN * _CAMERA.fy / (_CAMERA.height / 2)
    target, away = (low + high) / 2, np.array([0, -np.sin(_TILT), np.cos(_TILT)])
    T = geometry.look_at(target + distance * away, target)
    return Renderer(scene).render_color(_CAMERA, T, scene.index)


def _image_tag(png: bytes, text: str) -> str:
    """HTML of a picture that lies in the page itself."""
    return f"<img alt='{html.escape(text)}' src='data:image/png;base64," \
           f"{base64.b64encode(png).decode()}'>"
