# SPDX-License-Identifier: Apache-2.0
"""How much memory something takes."""

import tracemalloc
from contextlib import contextmanager


@contextmanager
def limited_memory(most_bytes=20_000_000):
    """Fails the test where Python and numpy make room for more than this at once."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < most_bytes, f"{peak / 1e6:.0f} MB at once"
