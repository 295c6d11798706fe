# SPDX-License-Identifier: Apache-2.0
import pytest

pytest.importorskip("rclpy")


@pytest.fixture
def ros(tmp_path):
    from kits.harness import Harness

    harness = Harness(tmp_path)
    yield harness
    harness.close()
