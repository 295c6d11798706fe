# SPDX-License-Identifier: Apache-2.0
"""What holds in each of the processes that share the tests."""

import os

import pytest

from stack_counter.ros import processes


@pytest.fixture(scope="session", autouse=True)
def domains_of_this_process():
    """No two processes draw the same ROS domain."""
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    processes.PRIVATE_DOMAINS = processes.PRIVATE_DOMAINS[number % count::count]
