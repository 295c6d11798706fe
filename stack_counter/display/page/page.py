# SPDX-License-Identifier: Apache-2.0
"""The page: everything known of one count, for people, in one file."""

from __future__ import annotations

import math
import time
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from stack_counter import __version__
from stack_counter.display.page import charts, pictures, viewer
from stack_counter.display.page.arranged_parts import arrangement_text
from stack_counter.display.page.poster import SETTINGS as POSTER
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.visible_parts import visible_text
from stack_counter.types import StackCount

_STAGES = {"load": "imports and weights", "read": "reading", "segment": "labels",
           "integrate": "fusing views", "finish": "container and V", "gamma": "gamma"}
_FIRST_DATE_S = 1e9  # September 2001: no recording is older
_SOURCES = {"estimator": "{0.estimator}", "piles": "simulated piles of the part",
            "counted": "counted bins of the part ({0.counted_scans})",
            "training": "piles of other parts"}
_PARTS_OF_V = {"seen": "seen", "filled": "filled in, unseen", "wall": "beside the wall"}


def render_page(count: StackCount, subject: ReportSubject, glb: bytes, poster: str,
                files: list[str]) -> str:
    """Returns the HTML of the report.

    Args:
        count: final count.
        subject: what it is of.
        glb: the model; empty where there is none.
        poster: data URI of its picture.
        files: names of the files beside the page.
    """
    volume = count.volume
    scripts = [viewer.viewer_script(), viewer.page_script()] if glb else []
    return _environment().get_template("report.html.j2").render(
        count=count, volume=volume, subject=subject, files=files, scripts=scripts,
        style=viewer.page_style(), policy=viewer.security_policy(*scripts),
        model=pictures.data_uri("model/gltf-binary", glb) if glb else "",
        arrangement=arrangement_text(subject.arrangement) if subject.arrangement else "",
        orbits=_orbits(count), poster=poster, poster_size=POSTER.size_px,
        key=pictures.key_picture(count), top=pictures.height_picture(volume),
        grid=charts.fill_grid(volume), histogram=charts.count_histogram(count),
        gamma_shares=_gamma_shares(count), volume_shares=_volume_shares(count),
        stages=_stages(count), settings=subject.setting_rows(), facts=_facts(count),
        stamp=_utc(volume.stamp_ns / 1e9), written=_utc(time.time()),
        versions={"stack_counter": __version__, "estimator": count.estimator,
                  "model-viewer": viewer.VIEWER_VERSION if glb else ""})


@cache
def _environment() -> Environment:
    """Returns what fills the template in: text is escaped, and a name that is missing an error."""
    return Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True,
                       undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def _orbits(count: StackCount) -> dict[str, str]:
    """Returns places of the viewer's camera by name, the container standing straight."""
    T = count.volume.container.T_world_container
    yaw = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    return {name: f"{azimuth + yaw:.1f}deg {polar:.0f}deg 101%" for name, azimuth, polar in (
        ("Oblique", POSTER.azimuth_deg, POSTER.polar_deg), ("Above", 0, 0), ("Side", 0, 78))}


def _gamma_shares(count: StackCount) -> list[charts.Share]:
    values = {_SOURCES.get(name, name).format(count): share
              for name, share in count.gamma_shares.items()}
    return charts.stacked_shares(values, {name: f"{share:.0%}" for name, share in values.items()})


def _volume_shares(count: StackCount) -> list[charts.Share]:
    parts = {_PARTS_OF_V[name]: max(part, 0.0)
             for name, part in count.volume.volume_parts.items()}
    if not sum(parts.values()):
        return []
    return charts.stacked_shares(parts, {name: f"{1e6 * part:.0f} cm³"
                                         for name, part in parts.items()})


def _stages(count: StackCount) -> list[tuple[str, float]]:
    """Returns what took time, s; the total is not one of them."""
    return [(text, count.seconds[stage]) for stage, text in _STAGES.items()
            if count.seconds.get(stage)]


def _facts(count: StackCount) -> list[tuple[str, str]]:
    """Returns what was measured beside V, by name."""
    volume, container = count.volume, count.volume.container
    size = " × ".join(f"{1000 * side:.0f}" for side in container.inner_size_m)
    low, mean, high = volume.fill_level
    facts = [("Container", container.kind)]
    if any(container.inner_size_m):
        facts += [("Inner size", f"{size} mm"),
                  ("Wall", f"{1000 * container.wall_thickness_m:.1f} mm"),
                  ("Fill level", f"{mean:.0%} (lowest {low:.0%}, highest {high:.0%})"
                                 + (", above the rim" if volume.overfilled else ""))]
    if len(count.sources) > 1:
        facts += [(f"Count by {s.source} alone", f"{s.count} ({s.count_interval[0]} to "
                   f"{s.count_interval[1]}), weighs {s.share:.1%}") for s in count.sources]
    facts += [("Footprint seen", f"{volume.coverage:.0%}")]
    if count.visible_parts is not None:
        facts.append(("Of the count", visible_text(count)))
    if volume.view_agreement_m:
        facts.append(("Views apart", f"{1000 * volume.view_agreement_m:.1f} mm"))
    if volume.missing_cameras:
        facts.append(("Cameras missing", ", ".join(volume.missing_cameras)))
    return facts


def _utc(seconds: float) -> str:
    """Returns a time since 1970, s, as a date; seconds of a clock that began with the scan."""
    if seconds < _FIRST_DATE_S:
        return f"{seconds:.1f} s"
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(seconds))
