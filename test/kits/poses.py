# SPDX-License-Identifier: Apache-2.0
"""Random poses of parts."""

import numpy as np
from scipy.spatial.transform import Rotation


def random_poses(count, seed=0):
    """(count, 7) positions, metres, in a box of some decimetres, and quaternions (x, y, z, w)."""
    random = np.random.default_rng(seed)
    return np.concatenate([random.uniform([-0.2, -0.1, 0.001], [0.2, 0.15, 0.3], (count, 3)),
                           Rotation.random(count, random_state=seed).as_quat()], axis=1)
