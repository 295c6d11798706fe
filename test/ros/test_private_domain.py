# SPDX-License-Identifier: Apache-2.0
"""ROS domains that nobody else on this machine uses."""

import os
import subprocess
import sys

import pytest

from stack_counter.ros import private_domain
from stack_counter.ros.private_domain import DomainError, PrivateDomain

A_NODE = """
import sys, rclpy
rclpy.init()
node = rclpy.create_node("a_cell")
print("up", flush=True)
sys.stdin.read()
"""


def test_two_replays_never_share_a_domain(monkeypatch):
    monkeypatch.setattr(private_domain, "_DOMAINS", range(97, 99))
    with PrivateDomain() as first, PrivateDomain() as second:
        assert {first.number, second.number} == {97, 98}
        assert first.environment["ROS_DOMAIN_ID"] == str(first.number)
        with pytest.raises(DomainError, match="all ROS domains from 97 to 98 are in use"):
            PrivateDomain()
    with PrivateDomain() as again:
        assert again.number in (97, 98)


@pytest.mark.parametrize("profile", ["", "stack_counter"])
def test_a_domain_in_which_a_node_runs_is_not_taken(monkeypatch, profile):
    pytest.importorskip("rclpy")
    monkeypatch.setattr(private_domain, "_DOMAINS", range(99, 100))
    with PrivateDomain() as domain:
        environment = {**os.environ, **domain.environment}
    if not profile:
        environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE")
    cell = subprocess.Popen([sys.executable, "-c", A_NODE], env=environment, text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert cell.stdout.readline() == "up\n"
        with pytest.raises(DomainError):
            PrivateDomain()
    finally:
        cell.communicate()
    PrivateDomain().close()
