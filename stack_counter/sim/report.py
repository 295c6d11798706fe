"""One page with pictures that shows what a folder of simulated scenes holds."""

from __future__ import annotations

import base64
import html
import io
import json
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import stats

from stack_counter import geometry
from stack_counter.sim.camera.render import Renderer
from stack_counter.sim.scenes.containers import KINDS
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.scenes.shards import read_failed_tries, read_shard
from stack_counter.sim.shapes import FAMILIES
from stack_counter.types import Intrinsics

PAGE, LOG = "report.html", "simulate.log"
LARGEST_SHARE = 0.12  # of the scenes, that one family may have
FULL = 0.9  # fill from which the border effect is measured
_SHOWN = 24  # scenes of the contact sheet
_CAMERA = Intrinsics(240, 180, 230.0, 230.0, 119.5, 89.5)
_TILT = np.deg2rad(40)  # of the camera from the vertical
_STYLE = """body{font:15px sans-serif;margin:2em;max-width:1240px}
td,th{text-align:left;vertical-align:top;padding:3px 14px 3px 0;border-bottom:1px solid #ddd}
figure{display:inline-block;margin:4px}figcaption{font-size:12px;max-width:240px}
img{max-width:100%}"""

Columns = dict[str, np.ndarray]  # one value a scene; NaN where a heap or an empty scene has none


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
    paths = sorted(folder.glob("shard_*.npz"))
    if not paths:
        raise SceneError(f"no shard_*.npz in {folder}; expected those that simulate writes")
    columns = _columns(paths)
    rows = _facts(columns, paths) + _rate(folder / LOG)
    table = "".join(f"<tr><th>{name}</th><td>{html.escape(text)}</td></tr>" for name, text in rows)
    plots = "".join(f"<p>{_image(png, title)}</p>" for title, png in _plots(columns))
    page = (f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>Simulated scenes"
            f"</title><style>{_STYLE}</style></head><body><h1>Simulated scenes</h1>"
            f"<p>{html.escape(str(folder.resolve()))}</p><table>{table}</table>{plots}"
            f"<h2>Scenes spread over the set</h2>{_contact_sheet(columns, paths)}</body></html>")
    out = out or folder / PAGE
    out.write_text(page, encoding="utf-8")
    return out


def _columns(paths: list[Path]) -> Columns:
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
                         **_row(scene)})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _row(scene: Scene) -> dict[str, Any]:
    """Width and depth in part sizes, and the wall as a share of the width; NaN for a heap."""
    box, truth = scene.container, scene.truth
    width, depth = (np.nan, np.nan) if box.kind == "none" \
        else (min(box.inner_size_m[:2]), box.inner_size_m[2])
    return {"family": scene.shape.family, "seed": scene.shape.seed, "kind": box.kind,
            "width": width / scene.shape.part_size, "depth": depth / scene.shape.part_size,
            "wall": box.wall_thickness_m / width,
            "count": truth.count, "gamma": truth.gamma, "fill": truth.fill,
            "gamma_whole": truth.gamma_whole, "gamma_center": truth.gamma_center}


def _facts(c: Columns, paths: list[Path]) -> list[tuple[str, str]]:
    """Rows of the table: name and text."""
    count, gamma = c["count"], c["gamma"][np.isfinite(c["gamma"])]
    parts, families = int(count.sum()), Counter(c["family"].tolist())
    size = sum(path.stat().st_size for path in paths)
    spread = np.percentile(gamma, (0, 5, 50, 95, 100)) if len(gamma) else [np.nan] * 5
    kinds = ", ".join(f"{kind} {np.mean(c['kind'] == kind):.1%}" for kind in KINDS)
    name, most = families.most_common(1)[0]
    skipped: Counter[str] = sum(map(read_failed_tries, paths), Counter())
    reasons = ", ".join(f"{reason} {n}" for reason, n in skipped.most_common())
    missing = ", ".join(sorted(set(FAMILIES) - set(families)))
    return [
        ("Scenes", f"{len(count):,} in {len(paths):,} shards"),
        ("Distinct parts", f"{len(set(zip(c['family'].tolist(), c['seed'].tolist()))):,}"),
        ("Families", f"{len(families)}; largest share {most / len(count):.1%} ({name}), "
                     f"at most {LARGEST_SHARE:.0%}"),
        ("Training families without a scene", missing or "none"),
        ("Parts in total", f"{parts:,}"),
        ("Count", f"mean {count.mean():.1f}, min {count.min()}, median {np.median(count):.0f}, "
                  f"max {count.max()}"),
        ("gamma", "min {:.3f}, 5% {:.3f}, median {:.3f}, 95% {:.3f}, max {:.3f}".format(*spread)),
        ("Scenes with gamma above 1", f"{np.sum(gamma > 1)}; empty {len(count) - len(gamma)}"),
        ("Containers", kinds),
        ("Failed tries", f"{skipped.total()} ({skipped.total() / len(count):.1%} of the scenes): "
                         f"{reasons or 'none'}"),
        ("On disk", f"{size / 1e6:.2f} MB, {size / max(parts, 1):.1f} bytes a part"),
    ]


def _rate(log: Path) -> list[tuple[str, str]]:
    """Row with the speed that the log states; a last line without its end is still in writing."""
    lines = log.read_text().rpartition("\n")[0].splitlines() if log.exists() else []
    if not lines:
        return []
    shards = [json.loads(line) for line in lines]
    seconds, scenes, parts = (sum(s[n] for s in shards) for n in ("seconds", "scenes", "parts"))
    workers = len({s["worker"] for s in shards})
    return [("Rate of one worker", f"{3600 * scenes / seconds:,.0f} scenes/h, "
             f"{parts / seconds:,.0f} parts/s; {len(shards)} shards by {workers} workers in "
             f"{seconds / 3600:.2f} h of their time")]


def _plots(c: Columns) -> list[tuple[str, bytes]]:
    """Titles and PNG files."""
    import matplotlib
    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    pages = []
    for title, size, draw in (
            ("Counts and gamma", (12, 4), _plot_gamma), ("Containers", (12, 4), _plot_fill),
            ("Families", (12, 4.5), _plot_families), ("Complexity C", (12, 4), _plot_complexity),
            ("Border effect", (12, 4), _plot_border)):
        figure, file = Figure(figsize=size, layout="constrained"), io.BytesIO()
        draw(figure, c)
        figure.suptitle(title)
        figure.savefig(file, format="png", dpi=100)
        pages.append((title, file.getvalue()))
    return pages


def _plot_gamma(figure: Any, c: Columns) -> None:
    counts, gammas, by_kind = figure.subplots(1, 3)
    low, high = max(1, c["count"].min()), c["count"].max() + 1
    _histogram(counts, c["count"], "count", np.geomspace(low, high, 40))
    counts.set_xscale("log")
    _histogram(gammas, c["gamma"], "gamma")
    kinds = [kind for kind in KINDS if (c["kind"] == kind).any()]
    by_kind.boxplot([_finite(c["gamma"][c["kind"] == kind]) for kind in kinds], whis=(5, 95),
                    tick_labels=kinds, flierprops={"markersize": 2})
    by_kind.tick_params(axis="x", rotation=30)
    by_kind.set(ylabel="gamma", title="whiskers: 5% and 95%")


def _plot_fill(figure: Any, c: Columns) -> None:
    fills, against, depths, walls = figure.subplots(1, 4)
    boxed = c["kind"] != "none"
    _histogram(fills, c["fill"][boxed], "fill")
    _scatter(against, c["width"][boxed], c["fill"][boxed], xlabel="width / part size",
             ylabel="fill")
    _histogram(depths, c["depth"], "depth / part size")
    _histogram(walls, c["wall"], "wall thickness / width")


def _plot_families(figure: Any, c: Columns) -> None:
    axes = figure.subplots()
    shares = Counter(c["family"].tolist()).most_common()
    names, scenes = [name for name, _ in shares], np.array([n for _, n in shares])
    axes.bar(names, scenes / scenes.sum())
    axes.axhline(LARGEST_SHARE, color="tab:red")
    axes.tick_params(axis="x", rotation=90)
    axes.set(ylabel="share of scenes", title=f"largest: {names[0]}, "
             f"{scenes[0] / scenes.sum():.1%}; line: {LARGEST_SHARE:.0%}")


def _plot_complexity(figure: Any, c: Columns) -> None:
    parts, against = figure.subplots(1, 2)
    first = np.unique(np.rec.fromarrays([c["family"], c["seed"]]), return_index=True)[1]
    _histogram(parts, c["complexity"][first], "complexity C of the distinct parts")
    _scatter(against, c["complexity"], c["gamma"], xlabel="complexity C", ylabel="gamma")


def _plot_border(figure: Any, c: Columns) -> None:
    """As in the paper's supplement, "Border Effects"; heaps have no borders."""
    histograms, against = figure.subplots(1, 2)
    full = (c["kind"] != "none") & (c["fill"] >= FULL)
    whole, center = c["gamma_whole"][full], c["gamma_center"][full]
    if not len(whole):
        histograms.set(title=f"no container is filled to {FULL:.0%}")
        return
    for values, name in ((whole, "with borders"), (center, "in the centre")):
        histograms.hist(values, np.linspace(0, max(1, whole.max(), center.max()), 41), alpha=0.6,
                        label=f"{name}: mean {values.mean():.3f}")
    histograms.legend()
    histograms.set(xlabel="occupancy ratio", ylabel="scenes", title=f"{len(whole)} containers, "
                   f"fill >= {FULL}: borders change it by {whole.mean() / center.mean() - 1:+.1%}")
    _scatter(against, whole, center, xlabel="gamma_whole", ylabel="gamma_center")
    against.axline((0, 0), slope=1, color="tab:red")


def _histogram(axes: Any, values: np.ndarray, label: str, bins: int | np.ndarray = 40) -> None:
    known = _finite(values)
    axes.hist(known, bins)
    axes.set(xlabel=label, ylabel="number", title=f"n = {len(known)}")


def _scatter(axes: Any, x: np.ndarray, y: np.ndarray, **settings: str) -> None:
    """Points, and in the title their correlation."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    axes.scatter(x, y, s=4, alpha=0.5)
    varied = len(x) > 2 and np.ptp(x) > 0 and np.ptp(y) > 0
    title = f"Spearman {stats.spearmanr(x, y)[0]:+.2f}, Pearson {stats.pearsonr(x, y)[0]:+.2f}" \
        if varied else "too few scenes for a correlation"
    axes.set(title=title, **settings)


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _contact_sheet(c: Columns, paths: list[Path]) -> str:
    """HTML with a picture of each of 24 scenes, or of all if there are fewer."""
    figures = []
    for i in np.unique(np.linspace(0, len(c["count"]) - 1, _SHOWN).astype(int)):
        scene = read_shard(paths[c["shard"][i]])[c["position"][i]]
        png = cv2.imencode(".png", _picture(scene)[..., ::-1])[1].tobytes()
        text = f"{scene.index}: {scene.shape.family}, {scene.container.kind}, " \
               f"{scene.truth.count} parts, gamma {scene.truth.gamma:.3f}"
        figures.append(f"<figure>{_image(png, text)}<figcaption>{html.escape(text)}"
                       "</figcaption></figure>")
    return "".join(figures)


def _picture(scene: Scene) -> np.ndarray:
    """(180, 240, 3) uint8 RGB of the whole scene, seen obliquely."""
    box, points = scene.container.mesh(), scene.parts_mesh().vertices.astype(float)
    points = points if box is None else np.concatenate([points, box.vertices])
    low, high = points.min(axis=0), points.max(axis=0)
    distance = np.linalg.norm(high - low) / 2 * 1.1 * _CAMERA.fy / (_CAMERA.height / 2)
    target, away = (low + high) / 2, np.array([0, -np.sin(_TILT), np.cos(_TILT)])
    T = geometry.look_at(target + distance * away, target)
    return Renderer(scene).render_color(_CAMERA, T, scene.index)


def _image(png: bytes, text: str) -> str:
    return f"<img alt='{html.escape(text)}' src='data:image/png;base64," \
           f"{base64.b64encode(png).decode()}'>"
