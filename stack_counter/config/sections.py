# SPDX-License-Identifier: Apache-2.0
"""Settings: one dataclass for each node; its fields are the node's ROS parameters.

The same YAML file (ROS parameter syntax) serves the nodes, launch and `--direct`:
`config/stack_counter.yaml` is the documented default of every setting.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from stack_counter.config import parameter_files
from stack_counter.config.named_region import REGIONS, NamedRegion, read_regions, write_regions
from stack_counter.config.setting_fields import build_section
from stack_counter.config.setting_fields import setting as _setting
from stack_counter.errors import ConfigError


@dataclass(frozen=True)
class CollectorConfig:
    """Which topics a camera speaks on, and which images are worth keeping."""

    mode: str = _setting("scan", "scan: from start_scan to stop_scan; continuous: a scan that "
                                 "never ends; cycle: each set of images of the rig is a scan",
                         choices=("scan", "continuous", "cycle"))
    part: str = _setting("", "name of the part, for scans that start by themselves; the counter's "
                             "where empty")
    unit_volume_m3: float = _setting(0.0, "volume of one part, m3; 0: the part's", 0.0)
    part_size_m: tuple[float, ...] = _setting((0.0, 0.0, 0.0), "sides of the box around one part, "
                                              "m; zeros: the part's", 0.0)
    part_catalogue: str = _setting("", "file of the known parts; empty: config/parts.yaml",
                                   path=True)
    rig: str = _setting("", "file that names several cameras; empty: one, as described below",
                        path=True)
    world_frame: str = _setting("base_link", "frame of the poses, z up")
    color_topic: str = _setting("/camera/color/image_raw", "colour images, without /compressed")
    color_transport: str = _setting(
        "auto", "how colour images come; auto: as they are published, raw where both are",
        choices=("auto", "raw", "compressed"))
    camera_info_topic: str = _setting("/camera/color/camera_info", "calibration of all images")
    depth_topic: str = _setting("/camera/aligned_depth_to_color/image_raw",
                                "depth images; empty: none")
    depth_camera_info_topic: str = _setting(
        "", "calibration of depth of another camera than colour's, which is registered by it and "
            "TF; empty: camera_info beside depth_topic")
    depth_scale: float = _setting(0.0, "metres that a unit of depth is, e.g. 0.0001; 0: as the "
                                       "encoding means, 16UC1 0.001, 32FC1 1", 0.0, 1.0)
    labels_topic: str = _setting("", "mono8 label images aligned to colour; empty: none")
    pose_source: str = _setting("tf", "where poses come from", choices=("tf", "topic"))
    pose_topic: str = _setting("/camera/pose",
                               "PoseStamped of the optical frame, if pose_source is topic")
    robot_description_file: str = _setting(
        "", "URDF of a robot that is left out of depth wherever it is in sight; empty: none",
        path=True)
    joint_states_topic: str = _setting("/joint_states", "JointState of that robot")
    reliable: bool = _setting(True, "ask camera topics for reliable delivery; set false for a "
                                    "driver that publishes best effort")
    tf_max_gap_s: float = _setting(0.1, "widest gap between TF samples that differ, to "
                                        "interpolate in, s", 0.0, 10.0)
    tf_timeout_s: float = _setting(2.0, "longest wait for the TF after an image, s", 0.0, 60.0)
    sync_tolerance_s: float = _setting(0.005, "stamp difference of images of one view, s",
                                       0.0, 1.0)
    min_motion_m: float = _setting(0.005, "a moving camera must move this far for another view, "
                                          "m", 0.0, 1.0, runtime=True)
    min_motion_rad: float = _setting(0.02, "or turn this far, rad", 0.0, math.pi, runtime=True)
    min_change: float = _setting(4.0, "grey-level change of some place, a thirtieth of the image "
                                      "wide, for another view from the same place", 0.0, 255.0,
                                 runtime=True)
    min_sharpness: float = _setting(2.0, "variance of the Laplacian below which an image is "
                                         "blurred, grey levels squared", 0.0, 10000.0,
                                    runtime=True)
    record_folder: str = _setting("", "folder that every scan is recorded to, one mcap file "
                                      "each; empty: none", path=True)
    record_max_mb: float = _setting(10000.0, "size of all recordings together, MB; the oldest are "
                                             "deleted", 1.0, 1e8)


@dataclass(frozen=True)
class ReconstructorConfig:
    """From views to V."""

    min_views: int = _setting(3, "fewest views for a volume", 1, 1000)
    max_views: int = _setting(200, "views beyond this number are skipped", 1, 10000)
    live: bool = _setting(False, "volume after every view from the first on, not only at the end")
    running_period_s: float = _setting(2.0, "a scan with depth says so often what it has so "
                                            "far, s; 0: never", 0.0, 3600.0)
    voxel_size: float = _setting(0.0, "side of a voxel, m; 0: 2 mm, less for small parts, more "
                                       "for large containers", 0.0, 0.1)
    trunc_voxels: float = _setting(2.0, "sdf_trunc in voxels", 1.0, 20.0)
    max_weight: float = _setting(20.0, "views that a voxel remembers: what is taken away is gone "
                                       "after as many", 1.0, 1000.0)
    max_memory_mb: float = _setting(1000.0, "memory of the voxels, MB; views that need more are "
                                            "skipped", 10.0, 100000.0)
    depth_min: float = _setting(0.1, "nearest depth used, m", 0.0, 10.0)
    depth_trunc: float = _setting(3.0, "farthest depth used, m", 0.1, 20.0)
    roi_center_m: tuple[float, ...] = _setting((0.0, 0.0, 0.0),
                                               "centre of the region of interest, world, m")
    roi_size_m: tuple[float, ...] = _setting((0.0, 0.0, 0.0),
                                             "its size along world x y z, m; zeros: found", 0.0)
    regions: tuple[NamedRegion, ...] = _setting(
        (), "named regions, each counted by itself, in place of roi_center_m and roi_size_m",
        read=read_regions)
    support_height_m: float = _setting(math.nan, "world z of the plane that containers stand on, "
                                                 "m; .nan: found in what is seen")
    container: str = _setting("", "name of a taught container; empty: none")
    container_catalogue: str = _setting("", "file of the taught containers; empty: "
                                            "config/containers.yaml", path=True)
    segmenter: str = _setting("auto", "who labels the views; auto: prompts if set, else depth, "
                                      "else the views' own labels",
                              choices=("auto", "geometric", "labels", "prompted", "sam2"))
    prompts: str = _setting("", "what is marked in the first view: a YAML file, or its text in "
                                "braces", runtime=True, path=True)
    sam2_weights: str = _setting("", "folder of a SAM 2 video model with safetensors, for sam2",
                                 path=True)
    container_kind: str = _setting("auto", "what holds the parts",
                                   choices=("auto", "box", "round", "free", "none"))
    container_inner_size_m: tuple[float, ...] = _setting(
        (0.0, 0.0, 0.0), "inner x and y at the rim, and floor-to-rim height, m; zeros: measured",
        0.0)
    container_floor_size_m: tuple[float, ...] = _setting(
        (0.0, 0.0), "inner x and y at the floor, from which the draft follows, m; zeros: the "
                    "draft is measured, or none where the pose is given", 0.0)
    container_wall_m: float = _setting(0.0, "wall thickness, m; 0: measured", 0.0, 0.2)
    container_floor_m: float = _setting(0.0, "floor thickness, m; 0: the wall's", 0.0, 0.2)
    container_pose: str = _setting("found", "where the container's pose comes from",
                                   choices=("found", "given"))
    container_xyyaw: tuple[float, ...] = _setting(
        (0.0, 0.0, 0.0), "x, y (m, world) and yaw (rad) of the container, if given")
    container_base_m: float = _setting(math.nan, "height of the container's underside above the "
                                                 "support plane, m; .nan: measured")
    hull_min_share: float = _setting(0.5, "share of the views that must see a voxel for it to "
                                          "stand, when there is no depth", 0.0, 1.0)
    depth_weights: str = _setting("", "folder with your own Depth Anything V2 weights, by which "
                                  "the depth of pictures is filled in where stereo measures none; "
                                  "empty: it is not", path=True)
    scale_std: float = _setting(0.0, "relative standard deviation of all lengths in the poses, as "
                                     "of pictures scaled by a reference; adds to V's", 0.0, 0.3)
    filling_level_cells: int = _setting(8, "cells of the filling level's grid along the "
                                           "container's longer side; they are as square as can be",
                                        1, 10)
    report_folder: str = _setting("", "folder into which the service write_report writes; empty: "
                                      "it does not", path=True)

    def __post_init__(self) -> None:
        """Raises ConfigError where a setting says one place beside the regions, which are many."""
        names = [region.name for region in self.regions]
        if names and any(self.roi_size_m):
            raise ConfigError(f"roi_size_m is {list(self.roi_size_m)} beside regions {names}; "
                              "expected one of them")
        if names and self.container_pose == "given":
            raise ConfigError(f"container_pose is 'given' beside regions {names}; expected "
                              "'found': each has a container of its own")

    def of_region(self, region: NamedRegion) -> ReconstructorConfig:
        """The settings with which one of the named regions is reconstructed."""
        return replace(self, regions=(), roi_center_m=region.center_m, roi_size_m=region.size_m)


@dataclass(frozen=True)
class CounterConfig:
    """From V to a count."""

    part: str = _setting("", "name of the part in the catalogue", runtime=True)
    unit_volume_m3: float = _setting(0.0, "volume of one part, m3; 0: the part's", 0.0,
                                     runtime=True)
    part_size_m: tuple[float, ...] = _setting((0.0, 0.0, 0.0), "sides of the box around one part, "
                                              "m; zeros: the part's", 0.0, runtime=True)
    part_catalogue: str = _setting("", "file of the known parts; empty: config/parts.yaml",
                                   path=True)
    estimator: str = _setting("network", "what says gamma", choices=(
        "network", "depth_corrected", "depth_extrapolated", "prior", "direct"))
    weights: str = _setting("", "safetensors file of the estimator; empty: the shipped one",
                            path=True)
    visible_parts_weights: str = _setting("", "safetensors file of what finds the parts that "
                                              "show; empty: the shipped one", path=True)
    visible_part_poses: int = _setting(0, "visible parts, the surest of which most shows, whose "
                                          "pose is found by the part's mesh; 0: of none", 0, 1000)
    encoder_weights: str = _setting("", "folder with your own DINOv2 weights, for estimator "
                                        "weights that were trained upon it; empty: none",
                                  path=True)
    depth_weights: str = _setting("", "folder with your own Depth Anything V2 weights, which read "
                                      "key views in colour only; empty: none", path=True)
    confidence: float = _setting(0.9, "probability that the interval holds the true count",
                                 0.01, 0.999, runtime=True)
    expected_count: int = _setting(0, "parts that every count is judged by; 0: none",
                                   0, 1000000000, runtime=True)
    tolerance: int = _setting(0, "largest deviation from expected_count that passes, parts",
                              0, 1000000000, runtime=True)
    weight_topic: str = _setting("", "std_msgs/Float64, what the scale under the container shows, "
                                     "kg; empty: no scale")
    weight_kg: float = _setting(math.nan, "the same as a number, in place of the topic, kg; .nan: "
                                          "none", runtime=True)
    tare_kg: float = _setting(0.0, "weight of the empty container, which is taken off, kg", 0.0,
                              100000.0, runtime=True)
    weight_std_kg: float = _setting(0.005, "standard deviation of the parts' weight: of the scale "
                                           "and of the tare, kg", 1e-6, 1000.0)
    weight_max_age_s: float = _setting(10.0, "how old a stable weight may be to belong to a scan, "
                                             "s", 0.1, 86400.0)
    timeout_s: float = _setting(60.0, "longest time of a scan that an action or service asks for "
                                      "without saying, s", 0.1, 86400.0, runtime=True)
    result_log: str = _setting("", "file to which a line is added for every final result: .csv, "
                                   "or .jsonl for JSON lines; empty: none", path=True)
    result_log_max_mb: float = _setting(100.0, "size of it and its older files together, MB; the "
                                               "oldest are deleted", 1.0, 1e8)
    result_json: bool = _setting(False, "publish every final result on the topic result_json as "
                                        "well: flat JSON, as stack-counter bridge reads it")

    def __post_init__(self) -> None:
        """Raises ConfigError where the log's name does not say how it is written."""
        if self.result_log and Path(self.result_log).suffix not in (".csv", ".jsonl"):
            raise ConfigError(f"result_log is '{self.result_log}'; expected a file that ends in "
                              ".csv or .jsonl")


@dataclass(frozen=True)
class Config:
    """All settings of the three nodes."""

    collector: CollectorConfig = CollectorConfig()
    reconstructor: ReconstructorConfig = ReconstructorConfig()
    counter: CounterConfig = CounterConfig()


_SECTIONS: dict[str, type] = {"collector": CollectorConfig, "reconstructor": ReconstructorConfig,
                              "counter": CounterConfig}
# Names of the settings of each node.
SETTING_NAMES = {node: frozenset(f.name for f in dataclasses.fields(section))
                 for node, section in _SECTIONS.items()}
Section = TypeVar("Section", CollectorConfig, ReconstructorConfig, CounterConfig)


def load_config(path: Path) -> Config:
    """Settings from a ROS parameter file; nodes it does not name keep their defaults.

    Raises:
        ConfigError: not YAML, unknown node or setting, value out of range.
        FileNotFoundError: no such file.
    """
    sections: dict[str, Any] = {
        node: build_section(_SECTIONS[node], parameter_files.without_ros_parameters(values))
        for node, values in read_parameters(path).items()}
    return Config(**sections)


def read_parameters(path: Path) -> dict[str, dict[str, Any]]:
    """Parameters by node of a ROS parameter file, unchecked, with those of ROS itself.

    Raises:
        ConfigError: not YAML, unknown node or setting.
        FileNotFoundError: no such file.
    """
    return parameter_files.read_parameter_file(path, SETTING_NAMES)


def to_ros_parameters(config: Config) -> str:
    """The settings as a ROS parameter file that `load` and the nodes read."""
    return parameter_files.write_parameter_file(
        {node: _to_ros_values(values) for node, values in vars(config).items()})


def _to_ros_values(section: Any) -> dict[str, Any]:
    """The settings of one node by name; without regions where there are none: ROS has no such."""
    values = {f.name: getattr(section, f.name) for f in dataclasses.fields(section)}
    regions = write_regions(values.pop(REGIONS, ()))
    return {**{key: list(value) if isinstance(value, tuple) else value
               for key, value in values.items()}, **({REGIONS: regions} if regions else {})}
