# SPDX-License-Identifier: Apache-2.0
"""Why a bag gives no count: `stack-counter doctor BAG`."""

from __future__ import annotations

from pathlib import Path

from stack_counter.bag.camera_topics import fit_rig_to_bag, missing_depth_line, topic_notes
from stack_counter.bag.formats.recording_file import decoding
from stack_counter.bag.reader import BagReader
from stack_counter.bag.sampling import sampled_parts
from stack_counter.bag.time_range import TimeRange
from stack_counter.config import Config
from stack_counter.errors import BagError
from stack_counter.views.checkup.checkup import Checkup
from stack_counter.views.checkup.diagnosis import diagnose
from stack_counter.views.checkup.findings import Finding, Severity
from stack_counter.views.checkup.summary import summary_lines
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


def check_bag(reader: BagReader, assembler: RigAssembler) -> tuple[Checkup, list[TimeRange]]:
    """Reads a bag, or parts of a long one, and notes what came.

    Args:
        reader: of the bag.
        assembler: fresh, of cameras that are fitted to it.

    Returns:
        What came, and the parts that were read.

    Raises:
        BagError: a message does not decode.
    """
    check = Checkup(assembler)
    color_topics = set(assembler.color_topics())
    parts = sampled_parts(reader, color_topics)
    for part in parts:
        for record in reader.part(part).records(set(check.topics), color_topics):
            with decoding(record):
                check.add(record.topic, record.decode(), len(record.data), record.log_time_ns)
        check.finish()
    return check, parts


def bag_findings(reader: BagReader, check: Checkup, config: Config, parts: list[TimeRange]
                 ) -> list[Finding]:
    """What keeps a bag from being counted, the cause first among equals.

    Args:
        reader: of the bag.
        check: of all of it, or of parts.
        config: the settings.
        parts: that were read.
    """
    rig, collector = check.assembler.rig, config.collector
    left_out = [note for note in topic_notes(collector, rig, reader.topics)
                if note.startswith("depth ")] \
        or [line for line in (missing_depth_line(collector, rig, reader.topics),) if line]
    # Of a long bag some images are seen, and it has many more.
    min_views = config.reconstructor.min_views if len(parts) == 1 else 1
    findings = diagnose(check, min_views, config.reconstructor, " ".join(left_out))
    return [*_truncated(reader, any(f.severity == Severity.STOPS for f in findings)), *findings]


def _truncated(reader: BagReader, stops: bool) -> list[Finding]:
    """A bag that is cut short: the cause of whatever else is missing."""
    return [Finding(Severity.STOPS if stops else Severity.HARMS, "the bag is cut short",
                    "record again, and end the recorder before the file is copied")] \
        if reader.truncated else []


def camera_finding(topics: dict[str, tuple[str, int]], error: BagError) -> Finding:
    """Why there are no colour images of the cameras.

    Args:
        topics: type name and number of messages by topic.
        error: of the search for them.
    """
    kinds = [kind for kind, _ in topics.values()]
    if not any("Image" in kind for kind in kinds):
        return Finding(Severity.STOPS, str(error),
                       "have the camera's driver publish images and calibrations, and record them")
    if _CAMERA_INFO not in kinds:
        return Finding(Severity.STOPS, f"no camera_info: {error}",
                       "have the driver publish camera_info beside its images, record it, and set "
                       "color_topic and camera_info_topic")
    return Finding(Severity.STOPS, str(error))


def examine_bag(path: Path, config: Config) -> tuple[list[str], list[Finding]]:
    """What came, a line each, and what is wrong.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: the settings.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read.
        ConfigError: the rig file cannot be used.
    """
    reader = BagReader(path)
    seconds = reader.duration_ns * 1e-9
    lines = [f"bag      {path}: {seconds:.1f} s, {reader.size / 1e6:.1f} MB, "
             f"{len(reader.topics)} topics"]
    try:
        rig = fit_rig_to_bag(load_rig(config.collector), reader.topics, reader.frame_of)
    except BagError as error:
        return lines, [*_truncated(reader, True), camera_finding(reader.topics, error)]
    check, parts = check_bag(reader, RigAssembler(rig, live=False))
    if len(parts) > 1:
        lines[0] += f"; looked at in {len(parts)} parts"
    lines += summary_lines(check, seconds, lambda stream: reader.topics.get(
        stream.topic, ("", 0))[1])
    lines += [f"note     {note}" for note in (
        *topic_notes(config.collector, rig, reader.topics), *check.assembler.notes)]
    return lines, bag_findings(reader, check, config, parts)
