# SPDX-License-Identifier: Apache-2.0
import pytest

pytest.importorskip("rclpy")


@pytest.fixture
def ros(tmp_path):
    from kits.harness import Harness

    harness = Harness(tmp_path)
    yield harness
    harness.close()


@pytest.fixture(scope="module")
def ros_of_module(tmp_path_factory):
    """For nodes that the tests of a file share: to start one takes seconds."""
    from kits.harness import Harness

    harness = Harness(tmp_path_factory.mktemp("ros"))
    yield harness
    harness.close()
