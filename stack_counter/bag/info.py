# SPDX-License-Identifier: Apache-2.0
"""What is in a bag, and what keeps it from being counted: `stack-counter info`."""

from __future__ import annotations

import time
from pathlib import Path

from stack_counter.bag.camera_topics import fit_rig_to_bag, topic_notes
from stack_counter.bag.doctor import bag_findings, camera_finding, check_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError
from stack_counter.types import View, ViewTally
from stack_counter.views.checkup.findings import Finding, cause_first
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


def describe_bag(path: Path, config: Config, time_range: TimeRange = WHOLE_BAG
                 ) -> tuple[str, list[Finding]]:
    """Describes topics, frames, views and problems, one a line.

    Of a long recording only parts are looked at, evenly spread over its images.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: the settings.
        time_range: the part of the bag whose images are looked at.

    Returns:
        The text, and the problems.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read.
        ConfigError: the rig file cannot be used.
    """
    reader = BagReader(path, time_range)
    lines = [_describe_extent(reader), "topics"]
    lines += [f"  {topic}  {kind}  {count}" for topic, (kind, count) in reader.topics.items()]
    lines += [f"recorded {key}: {value}" for key, value in reader.facts.items()]
    # Read the views, if there are images.
    try:
        rig = fit_rig_to_bag(load_rig(config.collector), reader.topics, reader.frame_of)
    except BagError as error:
        findings = [camera_finding(reader.topics, error)]
        return "\n".join([*lines, "problems", f"  {findings[0]}"]), findings
    check, parts = check_bag(reader, RigAssembler(rig, live=False))
    # Describe them, and name what is wrong.
    lines += [f"note     {note}" for note in (
        *topic_notes(config.collector, rig, reader.topics), *check.assembler.notes)]
    lines += [_describe_tally(check.assembler.tally, parts)]
    lines += _describe_views(check.first, check.last, rig.cameras[0].config,
                             config.collector.world_frame)
    findings = cause_first(bag_findings(reader, check, config, parts))
    problems = ["problems", *(f"  {finding}" for finding in findings)] if findings else []
    return "\n".join(lines + problems), findings


def _describe_extent(reader: BagReader) -> str:
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(reader.start_ns // 10**9))
    return f"bag      {reader.duration_ns * 1e-9:.3f} s from {began} UTC, " \
           f"{reader.size / 1e6:.1f} MB"


def _describe_tally(tally: ViewTally, parts: list[TimeRange]) -> str:
    """How many images can be used, and of how many that were looked at."""
    which = f" looked at, in {len(parts)} parts of the bag" if len(parts) > 1 else ""
    return f"views    {tally.used} usable of {tally.received}{which}" \
        + "".join(f", {n} {reason}" for reason, n in tally.skipped.items())


def _describe_views(first: View | None, last: View | None, camera: CollectorConfig,
                    world_frame: str) -> list[str]:
    if first is None or last is None:
        return []
    k, span_s = first.intrinsics, (last.stamp_ns - first.stamp_ns) * 1e-9
    return [f"frames   {first.camera} in {world_frame}",
            f"images   {k.width}x{k.height}, depth {'yes' if camera.depth_topic else 'no'}, "
            f"labels {'yes' if camera.labels_topic else 'no'}", f"duration {span_s:.1f} s"]
