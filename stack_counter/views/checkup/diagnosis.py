# SPDX-License-Identifier: Apache-2.0
"""From what came to what is wrong: the findings about cameras and TF, cause first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.views.checkup.checkup import Checkup
from stack_counter.views.checkup.findings import Finding, Severity, stops_count
from stack_counter.views.checkup.pictures import median
from stack_counter.views.checkup.streams import offsets_ns


@dataclass(frozen=True)
class DiagnosisSettings:
    """When what came is a finding; all are chosen.

    Attributes:
        skipped_share: share of the images that are skipped for one reason.
        valid_share: smallest share of valid depth.
        sharp_share: smallest share of sharp tiles of those that show something.
        units_m: units in which drivers send depth, metres.
        clocks_s: largest difference of two clocks, seconds: what TF may be late.
    """

    skipped_share: float = 0.1
    valid_share: float = 0.3
    sharp_share: float = 0.3
    units_m: tuple[float, ...] = (1.0, 0.001, 0.0001)
    clocks_s: float = 0.5


SETTINGS = DiagnosisSettings()
# What is done about images that are skipped; where nothing stands the error itself says it.
_REMEDIES = {
    "no_camera_info": "have the driver publish camera_info beside its images, record it, or set "
                      "camera_info_topic",
    "bad_intrinsics": "calibrate the camera, and have its driver send the result",
    "size_mismatch": "have the driver send the calibration of this resolution",
    "no_tf": "start what publishes the camera's pose before the camera, at 20 Hz or more (robot "
             "driver, robot_state_publisher, hand-eye calibration), and record /tf and /tf_static",
    "tf_loop": "let each frame have one parent",
    "bad_depth": "have the driver align depth to colour, or send camera_info with depth",
    "depth_not_aligned": "have the driver align depth to colour (RealSense: "
                         "align_depth.enable:=true)",
    "bad_encoding": "choose another format in the driver",
    "bad_image": "check the cable, the disk and the driver",
    "empty_depth": "check the depth camera: its laser, its range, and its cover",
    "blurred": "stop the camera for each image, expose shorter with more light, or focus; "
               "min_sharpness is the limit",
    "duplicate": "move the camera between images (min_motion_m, min_motion_rad)",
    "frame_changed": "let each camera publish on a topic of its own",
    "time_backwards": "record without playing an older bag at the same time",
    "bad_pose": "check what publishes the pose",
}
_USUAL = ("duplicate",)  # of a camera that stood still, which is fine if others are left


def diagnose(check: Checkup, min_views: int, reconstructor: ReconstructorConfig,
             left_out: str = "") -> list[Finding]:
    """What keeps the cameras from a count, or makes it worse.

    Args:
        check: has taken all messages.
        min_views: so many are enough.
        reconstructor: says which depth is used, and whether what is counted is marked, so that
            neither depth nor labels are needed.
        left_out: says why depth that is there is not used; empty: there is none, or it is used.

    Returns:
        Of equal severity in the order in which a view needs its parts.
    """
    few, has_prompts = check.assembler.tally.used < min_views, bool(reconstructor.prompts)
    findings = [*_silent_streams(check), *_frame_findings(check), *_bad_poses(check, few),
                *_clock_findings(check, few), *_skipped_views(check, few),
                *_missing_depth(check, has_prompts, left_out),
                *_depth_findings(check, few, reconstructor), *_blur_findings(check)]
    return findings if stops_count(findings) else [*findings, *_few_views(check, min_views)]


def _silent_streams(check: Checkup) -> list[Finding]:
    """Topics that a camera's views need and that gave nothing."""
    return [Finding(Severity.STOPS, f"no message on {s.topic}; expected "
                    f"{'colour images' if s.content == 'color' else 'poses'} there",
                    "start the driver, or set its topic for the collector")
            for s in check.streams.values() if s.content in ("color", "pose") and not s.stamps]


def _frame_findings(check: Checkup) -> list[Finding]:
    """The camera hangs below another root than the frame that is set."""
    color = check.stream_of("color")
    if not check.assembler.needs_tf or color is None or not color.stamps \
            or "no_tf" not in check.assembler.tally.skipped:
        return []
    camera = check.assembler.rig.cameras[0]
    world, frame = camera.config.world_frame, camera.frame or color.frame
    chain = check.tf.chain(frame)
    if world in chain or len(chain) == 1:
        return []
    known = f"; {world} is in no transform" if world not in (
        *check.tf.parents, *check.tf.parents.values()) else ""
    return [Finding(Severity.STOPS, f"'{frame}' hangs below '{chain[0]}', not below the "
                    f"world_frame '{world}'{known}",
                    f"set world_frame to '{chain[0]}' if its z axis points up, or publish a "
                    f"transform from '{world}' to '{chain[0]}'")]


def _bad_poses(check: Checkup, few: bool) -> list[Finding]:
    """Transforms or poses that were dropped: they are none."""
    lines = [a.last_error["bad_pose"] for a in check.assembler.assemblers.values()
             if "bad_pose" in a.last_error]
    return [Finding(Severity.STOPS if few else Severity.HARMS, line, _REMEDIES["bad_pose"])
            for line in lines[:1]]  # all cameras hear the same transforms


def _skipped_views(check: Checkup, few: bool) -> list[Finding]:
    """Why images give no view, the most frequent reason first."""
    tally, findings = check.assembler.tally, []
    named_frame = bool(_frame_findings(check))
    lines = {reason: f"{name}: {line}" if name else line
             for name, assembler in check.assembler.assemblers.items()
             for reason, line in assembler.last_error.items()}
    for reason, count in sorted(tally.skipped.items(), key=lambda item: -item[1]):
        if reason == "no_tf" and named_frame or reason in _USUAL and not few \
                or count < SETTINGS.skipped_share * tally.received:
            continue
        severity = Severity.STOPS if few else Severity.HARMS
        remedy = _sync_remedy(check) if reason == "unsynchronised" else _REMEDIES.get(reason, "")
        findings.append(Finding(severity, f"{count} of {tally.received} images skipped, "
                                f"{lines.get(reason, reason)}", remedy))
    return findings


def _sync_remedy(check: Checkup) -> str:
    """What is done about depth whose stamps are not those of colour."""
    color, depth = check.stream_of("color"), check.stream_of("depth")
    offsets = offsets_ns(depth, color) if color and depth else np.zeros(0, np.int64)
    if not len(offsets):
        return "start the depth stream, or record its topic"
    off_s = float(np.median(np.abs(offsets))) * 1e-9
    remedy = (f"half of the depth is {off_s * 1e3:.1f} ms off or more: have the driver "
              "synchronise both streams (RealSense: enable_sync:=true)")
    return remedy if off_s > SETTINGS.clocks_s else \
        f"{remedy}, or, if the camera stands still for images, set sync_tolerance_s to " \
        f"{1.5 * off_s:.2g}"


def _missing_depth(check: Checkup, has_prompts: bool, left_out: str) -> list[Finding]:
    """Nothing says what is where: neither depth nor labels nor marks."""
    if any(stream.content in ("depth", "labels") for stream in check.streams.values()):
        return []
    return [Finding(Severity.HARMS if has_prompts else Severity.STOPS,
                    left_out or "neither depth nor labels: nothing to carve with",
                    "" if left_out else "switch the driver's depth on and record it, set "
                    "depth_topic or labels_topic, or mark the parts (prompts)")]


def _clock_findings(check: Checkup, few: bool) -> list[Finding]:
    """Cameras and TF have clocks that differ."""
    color = check.stream_of("color")
    if color is None or not color.stamps or not check.tf.delays:
        return []
    difference = color.delay_s - check.tf.delay_s
    if abs(difference) <= SETTINGS.clocks_s:
        return []
    behind = "behind" if difference > 0 else "ahead of"
    stops = few and "no_tf" in check.assembler.tally.skipped
    return [Finding(Severity.STOPS if stops else Severity.HARMS,
                    f"the stamps of {color.topic} are {abs(difference):.1f} s "
                    f"{behind} those of /tf; expected one clock",
                    "synchronise the clocks of camera, robot and this machine (chrony, ptp), and "
                    "let all use the same use_sim_time")]


def _depth_findings(check: Checkup, few: bool, reconstructor: ReconstructorConfig
                    ) -> list[Finding]:
    """Depth in a wrong unit, or with much of it missing."""
    p, depth, findings = check.pictures, check.stream_of("depth"), []
    topic = depth.topic if depth else ""
    findings += [Finding(Severity.STOPS if few else Severity.HARMS, str(error),
                         _REMEDIES.get(reason, ""))
                 for reason, error in check.picture_errors.items()
                 if reason not in check.assembler.tally.skipped]
    nearest, farthest = reconstructor.depth_min, reconstructor.depth_trunc
    distance = median(p.distances)
    if p.distances and not nearest <= distance <= farthest:
        used = check.assembler.rig.cameras[0].config.depth_scale \
            or (1.0 if depth and "32FC1" in depth.form else 0.001)
        scale = next((unit for unit in SETTINGS.units_m
                      if nearest <= distance / used * unit <= farthest), None)
        near, far = np.median(p.ranges, axis=0)
        findings.append(Finding(
            Severity.STOPS if near > farthest or far < nearest else Severity.HARMS,
            f"half of the depth on {topic} is "
            f"{'nearer' if distance < nearest else 'farther'} than {distance:.3g} m, taken in "
            f"units of {used:g} m; expected {nearest:g} to {farthest:g} m (depth_min, "
            "depth_trunc)", "if that is not so, "
            + (f"set depth_scale to {scale:g}, the metres of a unit" if scale else
               "set depth_scale to the metres of a unit") + "; else bring the camera nearer"))
    if p.valid and median(p.valid) < SETTINGS.valid_share:
        findings.append(Finding(
            Severity.HARMS, f"{median(p.valid):.0%} of the depth on {topic} is valid; expected "
            f"{SETTINGS.valid_share:.0%} or more", "bring the camera into its range, switch its "
            "projector on, and keep sun and glossy surfaces out"))
    return findings


def _blur_findings(check: Checkup) -> list[Finding]:
    """Pictures without anything sharp."""
    sharp = median(check.pictures.sharp)
    return [] if "blurred" in check.assembler.tally.skipped or not sharp < SETTINGS.sharp_share \
        else [Finding(
            Severity.HARMS, f"the pictures are blurred, {sharp:.0%} of what they show is sharp; "
            f"expected {SETTINGS.sharp_share:.0%} or more", _REMEDIES["blurred"])]


def _few_views(check: Checkup, min_views: int) -> list[Finding]:
    """There are not enough views, and nothing else says why."""
    used = check.assembler.tally.used
    return [] if used >= min_views else [
        Finding(Severity.STOPS, f"{used} usable views; expected {min_views} or more (min_views)",
                "record more images from other places, or set min_views of the reconstructor")]
