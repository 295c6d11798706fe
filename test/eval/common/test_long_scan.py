# SPDX-License-Identifier: Apache-2.0
"""The memory that a process has used."""

import numpy as np

from stack_counter.eval.common import long_scan


def test_peak_memory_stays_after_the_array_is_gone():
    block = np.ones(60_000_000)  # 480 MB
    size = block.nbytes / 1e6
    del block
    assert long_scan.peak_memory_mb() > size
