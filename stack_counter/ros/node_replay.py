# SPDX-License-Identifier: Apache-2.0
"""Counts a bag by the three real nodes: `replay --nodes`."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg

from stack_counter.bag.bag_scale import with_weight_of_bag
from stack_counter.bag.bag_views import subscribed_topics, with_scale_of_bag
from stack_counter.bag.camera_topics import fit_rig_to_bag, topic_notes
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replayed import (
    Replayed,
    count_entry,
    failed_cycle_entry,
    no_count_line,
    replayed_cycles,
    require_count,
)
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import CollectorConfig, Config
from stack_counter.counting import with_reasons
from stack_counter.ros.conversions import from_stack_count, from_stack_volume, from_tally
from stack_counter.ros.heard_counts import HeardCounts
from stack_counter.ros.player import Player
from stack_counter.ros.private_domain import PrivateDomain
from stack_counter.ros.processes import NodeProcesses
from stack_counter.ros.security import check_security
from stack_counter.types import PartRequest, Reason, StackCount, ViewTally
from stack_counter.views.cycles import cycle_stamp_ns
from stack_counter.views.rig import Rig, load_rig
from stack_counter.views.rig_assembler import RigAssembler


@dataclass(frozen=True)
class NodeReplaySettings:
    """How the nodes are set up for a bag.

    Attributes:
        tf_timeout_s: seconds that the collector waits for a pose which the bag may still hold.
            Chosen; all that the bag has will come, however slowly.
    """

    tf_timeout_s: float = 20.0


SETTINGS = NodeReplaySettings()


def replay_nodes(path: Path, config: Config, part: PartRequest, rate: float,
                 on_view: Callable[[], None], begin: float, time_range: TimeRange = WHOLE_BAG
                 ) -> list[Replayed]:
    """Plays a bag through collector, reconstructor and counter over DDS.

    Args:
        path: rosbag2 folder, or a file of a recording.
        config: settings; topics are fitted to the bag.
        part: what is in the bin.
        rate: 0 to play as fast as the nodes process images, or the speed of the recording's
            clock.
        on_view: called for each image played.
        begin: when the command began, seconds of `time.perf_counter`: imports count as loading.
        time_range: the part of the bag whose images are used.

    Returns:
        One result for each named region, at least one of them with a count; one without names.

    Raises:
        BagError: the bag cannot be read, or has no usable topics.
        NodeError: a node died or hangs.
        ScanError: the nodes give no count; the message has their reason.
        ConfigError: security is asked for and cannot be had.
    """
    check_security()
    domain = PrivateDomain()
    os.environ.update(domain.environment)  # read by the DDS library when the context starts
    reader = BagReader(path, time_range)
    config = with_scale_of_bag(config, reader)
    rig = fit_rig_to_bag(load_rig(config.collector), reader.topics, reader.frame_of)
    config, scale_notes = _with_scale(config, rig, reader)
    nodes = NodeProcesses(
        replace(config, collector=_fit_collector(config.collector, rig, reader)),
        domain.environment)
    regions = [region.name for region in config.reconstructor.regions] or [""]
    with domain, _spinning_player(rig, reader, config.collector.mode == "cycle", regions, nodes,
                                  domain.number) as player, nodes:
        # Start the nodes.
        player.wait_for_nodes()
        loaded = time.perf_counter()
        # Play the scan.
        player.start_scan(part)
        player.play(reader, rate, on_view)
        played = time.perf_counter()
        # Wait for its counts.
        scan_id = player.stop_scan()
    seconds = {"load": loaded - begin, "read": played - loaded,
               "total": time.perf_counter() - begin}
    results = [_collect_cycles(player.heard, region) if config.collector.mode == "cycle"
               else _collect_scan(player.heard, region, scan_id, config.reconstructor.live)
               for region in regions]
    notes = [*topic_notes(config.collector, rig, reader.topics), *scale_notes]
    return [replace(result, notes=tuple(notes)) for result in require_count(
        _finish_result(result, reader.truncated, seconds) for result in results)]


def _with_scale(config: Config, rig: Rig, reader: BagReader) -> tuple[Config, list[str]]:
    """Returns settings with the weight of a bag, and a note where the nodes cannot be told it.

    A topic of numbers has no stamps, and the nodes get what is played as fast as they can.
    """
    if config.collector.mode != "cycle" and not config.reconstructor.live:
        topics = set(RigAssembler(rig).color_topics())
        return with_weight_of_bag(config, reader, topics), []
    if config.counter.weight_topic not in reader.topics:
        return config, []
    return replace(config, counter=replace(config.counter, weight_topic="")), [
        f"the weights on {config.counter.weight_topic} were not used: which of them belongs to a "
        "cycle or a view, --direct alone can tell"]


def _fit_collector(config: CollectorConfig, rig: Rig, reader: BagReader) -> CollectorConfig:
    """Returns the collector's settings for the bag's topics.

    The collector waits long for poses where the bag has a topic of them and every calibration:
    what the bag lacks is not worth a long wait.
    """
    fitted = config if config.rig else rig.cameras[0].config
    has_poses = bool({"/tf", "/tf_static", fitted.pose_topic} & set(reader.topics))
    if has_poses and all(c.config.camera_info_topic in reader.topics for c in rig.cameras):
        fitted = replace(fitted, tf_timeout_s=SETTINGS.tf_timeout_s)
    return fitted


@contextmanager
def _spinning_player(rig: Rig, reader: BagReader, cycles: bool, regions: list[str],
                     nodes: NodeProcesses, domain_id: int) -> Iterator[Player]:
    """Spins a player of the bag in a thread, on a ROS domain of its own."""
    context = rclpy.context.Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    assembler = RigAssembler(rig)
    topics = {name: reader.topics[name][0] for name in subscribed_topics(assembler)
              if name in reader.topics}
    player = Player(nodes, set(assembler.color_topics()), topics,
                    round(rig.tolerance_s * 1e9) if cycles else 0, regions, context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(player)
    spinner = threading.Thread(target=_spin, args=(executor,), daemon=True)
    spinner.start()
    try:
        yield player
    finally:
        executor.shutdown()
        player.destroy_node()
        rclpy.try_shutdown(context=context)
        spinner.join()


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass


def _collect_scan(heard: HeardCounts, region: str, scan_id: str, live: bool) -> Replayed:
    """Returns what the nodes have counted in one region of a scan; `live`: list all its counts."""
    counts = [count for count in heard.counts[region] if count.scan_id == scan_id]
    final = next(count for count in counts if count.final)
    # Running counts may have come after the final one, which has the stamp of the last of them.
    ordered = sorted(counts, key=lambda count: count.final)
    by_stamp = {entry["stamp_ns"]: entry for entry in map(
        _count_entry, (count for count in ordered if live and not count.error))}
    if final.error:
        line = no_count_line(final.error, from_tally(final.views), [])
        return Replayed(None, list(by_stamp.values()), line, region)
    return Replayed(_last_count(heard, region), list(by_stamp.values()), region=region)


def _collect_cycles(heard: HeardCounts, region: str) -> Replayed:
    """Returns what the nodes have counted in one region of a rig's cycles: all final counts."""
    finals = [count for count in heard.counts[region] if count.final]
    entries = [failed_cycle_entry(cycle_stamp_ns(count.scan_id), count.error,
                                  count.missing_cameras) if count.error else _count_entry(count)
               for count in finals]
    tallies = [from_tally(count.views) for count in finals]
    tally = ViewTally(sum(t.received for t in tallies), sum(t.used for t in tallies),
                      dict(sum((Counter(t.skipped) for t in tallies), Counter())))
    return replayed_cycles(region, entries, _last_count(heard, region), tally, [])


def _last_count(heard: HeardCounts, region: str) -> StackCount | None:
    """Returns the last count of a region with its volume; None if there is none."""
    if region not in heard.last:
        return None
    count, volume = heard.last[region]
    return from_stack_count(count, from_stack_volume(volume))


def _finish_result(result: Replayed, truncated: bool, seconds: dict[str, float]) -> Replayed:
    """Returns a result that says what is known here: a bag cut short, and time spent, s."""
    count = result.count
    if count is None:
        return result
    if truncated:
        count = with_reasons(count, Reason.BAG_TRUNCATED)
    return replace(result, count=replace(count, seconds={**count.seconds, **seconds}))


def _count_entry(message: StackCountMsg) -> dict:
    """Returns the JSON entry of one count; of its volume that needs stamp and cameras alone."""
    volume = StackVolumeMsg(header=message.header, missing_cameras=message.missing_cameras)
    return count_entry(from_stack_count(message, from_stack_volume(volume)))
