# SPDX-License-Identifier: Apache-2.0
"""What is in a bag, and what keeps it from being counted: `stack-counter info`."""

from __future__ import annotations

from pathlib import Path

from stack_counter.bag.bag_views import read_views
from stack_counter.bag.camera_topics import fit_rig_to_bag, missing_depth_line, topic_notes
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.types import View, ViewTally
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


def describe_bag(path: Path, config: CollectorConfig) -> str:
    """Describes topics, frames, views and problems, one a line.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read.
    """
    reader = BagReader(path)
    lines = ["topics"] + [f"  {topic}  {kind}  {count}"
                          for topic, (kind, count) in reader.topics.items()]
    lines += [f"recorded {key}: {value}" for key, value in reader.facts.items()]
    # Read the views, if there are images.
    try:
        rig = fit_rig_to_bag(load_rig(config), reader.topics)
    except BagError as error:
        return "\n".join([*lines, "problems", f"  {error}"])
    assembler = RigAssembler(rig, live=False)
    views = [view for _, view in read_views(reader, assembler)]
    # Describe them, and name what is wrong.
    fitted = rig.cameras[0].config
    lines += [f"note     {note}" for note in (*topic_notes(config, rig, reader.topics),
                                              *assembler.notes)]
    lines += _describe_views(views, assembler.tally, fitted, config.world_frame)
    problems = (["the bag is cut short"] if reader.truncated else []) + assembler.last_errors
    if not fitted.depth_topic and not fitted.labels_topic:
        problems.append("neither depth nor labels: nothing to carve with")
        problems += filter(None, [missing_depth_line(config, rig, reader.topics)])
    return "\n".join(lines + (["problems"] + [f"  {p}" for p in problems] if problems else []))


def _describe_views(views: list[View], tally: ViewTally, camera: CollectorConfig,
                    world_frame: str) -> list[str]:
    lines = [f"views    {tally.used} usable of {tally.received}"
             + "".join(f", {n} {reason}" for reason, n in tally.skipped.items())]
    if not views:
        return lines
    k, span_s = views[0].intrinsics, (views[-1].stamp_ns - views[0].stamp_ns) * 1e-9
    return [*lines, f"frames   {views[0].camera} in {world_frame}",
            f"images   {k.width}x{k.height}, depth {'yes' if camera.depth_topic else 'no'}, "
            f"labels {'yes' if camera.labels_topic else 'no'}", f"duration {span_s:.1f} s"]
