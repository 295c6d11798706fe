# SPDX-License-Identifier: Apache-2.0
"""Samples of pictures that were made up, for what learns from them."""

import numpy as np

from stack_counter.train.data.pictures import SIDE_PX, PictureSample


def made_up(count, family="nut", seed=0):
    """Discs at random places on a grey ground."""
    random = np.random.default_rng((count, seed))
    color = np.full((SIDE_PX, SIDE_PX, 3), 60, np.uint8)
    centers = random.uniform(20, SIDE_PX - 20, (count, 2))
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    for cx, cy in centers:
        color[np.hypot(x - cx, y - cy) < 9] = 220
    boxes = np.concatenate([centers - 9, centers + 9], 1)
    return PictureSample(color, centers.astype(np.float32), boxes.astype(np.float32), count,
                         0.3 + count / 1000, family, f"0:{count}")
