# SPDX-License-Identifier: Apache-2.0
"""A recording of a station made in code: small fixed cameras, and cycles that give no count.

Running volumes come after every view.
"""

from __future__ import annotations

from dataclasses import replace

import yaml
from kits.bags import bin_views, picture

from stack_counter.bag.writer import Transform, write_rig_bag


def station(tmp_path, cycles=4, failed=(), blurred=(), cameras=4):
    """Paths of a recording and its settings.

    In a failed cycle one camera alone gives an image; in a blurred one no image is of use.
    """
    views = bin_views(count=cameras)
    poses = {f"camera{i}": view.T_world_camera for i, view in enumerate(views)}
    recorded = {name: [
        replace(view, camera=f"{name}_frame", stamp_ns=(k + 1) * 10**9,
                color=picture(10 * k + i) // (255 if k in blurred else 1))
        for k in range(cycles) if i == 0 or k not in failed]
        for i, (name, view) in enumerate(zip(poses, views))}
    write_rig_bag(tmp_path / "station", recorded, [
        Transform(10**9, "base_link", f"{name}_frame", pose) for name, pose in poses.items()])
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({
        "cameras": {name: {
            "color_topic": f"/{name}/color/image_raw", "color_transport": "compressed",
            "camera_info_topic": f"/{name}/color/camera_info",
            "depth_topic": f"/{name}/aligned_depth_to_color/image_raw"} for name in poses},
        "trigger": {"tolerance_s": 0.05, "timeout_s": 0.5}}))
    settings = tmp_path / "station.yaml"
    settings.write_text(yaml.safe_dump({
        "/stack_counter/collector": {"ros__parameters": {
            "mode": "cycle", "rig": str(tmp_path / "rig.yaml")}},
        "/stack_counter/reconstructor": {"ros__parameters": {"running_period_s": 0.01}}}))
    return tmp_path / "station", settings
