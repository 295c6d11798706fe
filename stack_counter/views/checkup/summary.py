# SPDX-License-Identifier: Apache-2.0
"""What came, for people: a line for each stream, for sync, TF, depth, sharpness and views."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stack_counter.views.checkup.checkup import Checkup
from stack_counter.views.checkup.pictures import median
from stack_counter.views.checkup.streams import Stream, offsets_ns


def summary_lines(check: Checkup, seconds: float, count: Callable[[Stream], int]) -> list[str]:
    """Describes what came, in some ten lines.

    Args:
        check: has taken all messages.
        seconds: in which the messages came.
        count: number of messages of a stream in all, of which it may hold a part.
    """
    color = check.stream_of("color")
    camera = check.assembler.rig.cameras[0]
    lines = [stream.describe(count(stream), seconds) for stream in check.streams.values()
             if stream.stamps or stream.content != "depth_info"]
    if color is not None and color.stamps:
        lines.append(_describe_sync(check, color, camera.config.sync_tolerance_s))
    lines.append(f"{check.tf.describe(camera.frame or (color.frame if color else ''))}"
                 f"; world_frame {camera.config.world_frame}")
    p = check.pictures
    if p.valid:
        scale = camera.config.depth_scale
        unit = f"{scale:g} m a unit" if scale else "unit by encoding"
        lines.append(f"depth    {median(p.valid):.0%} valid, median {median(p.distances):.3g} m "
                     f"({unit}), in {len(p.valid)} pictures")
    if p.sharp:
        lines.append(f"sharp    {median(p.sharp):.0%} of what the picture shows, in "
                     f"{len(p.sharp)} pictures")
    tally = check.assembler.tally
    return [*lines, f"views    {tally.used} usable of {tally.received}" + "".join(
        f", {n} {reason}" for reason, n in tally.skipped.items())]


def _describe_sync(check: Checkup, color: Stream, tolerance_s: float) -> str:
    """How many colour images have each partner near."""
    parts = []
    for content, name in (("depth", "depth"), ("labels", "labels"), ("info", "camera_info")):
        stream = check.stream_of(content)
        if stream is None:
            continue
        offsets = offsets_ns(stream, color)
        near = np.abs(offsets) <= tolerance_s * 1e9
        worst = f" (at most {np.abs(offsets).max() / 1e6:.1f} ms off)" if len(offsets) else ""
        parts.append(f"{name} near {near.mean() if len(near) else 0:.0%}{worst}")
    return f"sync     of colour images, {', '.join(parts)}; tolerance {tolerance_s * 1e3:g} ms"
