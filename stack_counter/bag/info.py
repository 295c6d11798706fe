"""What is in a bag, and what keeps it from being counted."""

from __future__ import annotations

from pathlib import Path

from stack_counter.bag.reader import BagReader, fit_rig, read_views
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError
from stack_counter.views.rig import RigAssembler, load_rig


def describe(path: Path, config: CollectorConfig) -> str:
    """Topics, frames, views and problems, one a line.

    Raises:
        FileNotFoundError, BagError: no bag, or none that can be read.
    """
    reader = BagReader(path)
    lines = ["topics"] + [f"  {topic}  {kind}  {count}"
                          for topic, (kind, count) in reader.topics.items()]
    lines += [f"recorded {key}: {value}" for key, value in reader.facts.items()]
    problems = ["the bag is cut short"] if reader.truncated else []
    try:
        rig = fit_rig(load_rig(config), reader.topics)
    except BagError as error:
        return "\n".join([*lines, "problems", f"  {error}"])
    assembler = RigAssembler(rig, live=False)
    views = [view for _, view in read_views(reader, assembler)]
    tally, fitted = assembler.tally, rig.cameras[0].config
    lines.append(f"views    {tally.used} usable of {tally.received}"
                 + "".join(f", {n} {reason}" for reason, n in tally.skipped.items()))
    if views:
        k = views[0].intrinsics
        span = (views[-1].stamp_ns - views[0].stamp_ns) * 1e-9
        lines += [f"frames   {views[0].camera} in {config.world_frame}",
                  f"images   {k.width}x{k.height}, depth {'yes' if fitted.depth_topic else 'no'}, "
                  f"labels {'yes' if fitted.labels_topic else 'no'}", f"duration {span:.1f} s"]
    problems += assembler.last_errors
    if not fitted.depth_topic and not fitted.labels_topic:
        problems.append("neither depth nor labels: nothing to carve with")
    return "\n".join(lines + (["problems"] + [f"  {p}" for p in problems] if problems else []))
