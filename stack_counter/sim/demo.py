"""Makes the recording that the demo and the tests replay.

    python -m stack_counter.sim.demo OUT
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.bag.writer import Transform, write_bag
from stack_counter.sim.piles import Plan, drop
from stack_counter.sim.recording import FRAME, record
from stack_counter.sim.scene import Scene
from stack_counter.sim.shapes import make_shape
from stack_counter.sim.truth import truth_of
from stack_counter.types import View

_SEED = 26
_TF_STEP_NS = 20_000_000  # 50 Hz


def demo_scene() -> Scene:
    """Hex nuts in an oblong bin with a wall and a floor of 3 mm, some three quarters full."""
    random = np.random.default_rng(_SEED)
    shape = make_shape(_SEED, "nut")
    size = shape.part_size
    plan = Plan(shape, np.array([0.19, 0.25, 0.11]) / size, 0.003 / size, 0.003 / size, fill=0.6,
                friction=0.4, restitution=0.1)
    return drop(plan, random, _SEED, 0)


def arm_transforms(views: list[View], world_frame: str = "base_link") -> list[Transform]:
    """/tf of the arm at 50 Hz, in rest around each exposure, moving in between."""
    out: list[Transform] = []
    for before, after in zip(views, views[1:] + views[-1:]):
        for stamp in range(before.stamp_ns - 2 * _TF_STEP_NS, after.stamp_ns - 2 * _TF_STEP_NS
                           if after is not before else before.stamp_ns + 3 * _TF_STEP_NS,
                           _TF_STEP_NS):
            share = np.clip((stamp - before.stamp_ns - 2 * _TF_STEP_NS)
                            / max(after.stamp_ns - before.stamp_ns - 4 * _TF_STEP_NS, 1), 0, 1)
            T = geometry.interpolate(before.T_world_camera, after.T_world_camera, float(share))
            out.append((stamp + 7_000_000, world_frame, FRAME, T))
    return out


def main() -> int:
    """Writes the bag and `truth.json` in it."""
    out = Path(sys.argv[1])
    scene = demo_scene()
    truth = truth_of(scene)
    views = record(scene, views=12, seed=_SEED)
    write_bag(out, views, arm_transforms(views))
    (out / "truth.json").write_text(json.dumps({
        "count": truth.count, "unit_volume_cm3": truth.unit_volume * 1e6,
        "volume_m3": truth.stack_volume, "gamma": truth.gamma, "family": scene.shape.family,
        "inner_size_m": scene.container.inner_size_m, "seed": _SEED}, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
