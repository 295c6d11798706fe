# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy grants what the interface table lists, and nothing else."""

from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
# Of every lifecycle node.
OWN = {"/parameter_events", "/clock", "/rosout", "~/transition_event"}
HOW = {("topics", "subscribe"): "subscribes", ("topics", "publish"): "publishes",
       ("services", "reply"): "serves", ("services", "request"): "calls",
       ("actions", "execute"): "offers"}


def test_the_policy_grants_what_the_table_lists():
    rows = [line.split("|")[1:4] for line in (ROOT / "docs" / "interface.md").read_text()
            .splitlines() if line.startswith("| ") and not line.startswith("| node")]
    listed = {tuple(cell.strip().strip("`") for cell in row) for row in rows}
    granted = set()
    for enclave in ElementTree.parse(ROOT / "config" / "sros2_policy.xml").iter("enclave"):
        profile = enclave.find("profiles/profile")
        node = profile.get("node")
        assert enclave.get("path") == f"{profile.get('ns')}/{node}"
        for group in profile:
            (attribute, value), = group.attrib.items()
            assert value == "ALLOW"
            granted |= {(node, HOW[group.tag, attribute], item.text) for item in group
                        if item.text not in OWN and not (group.tag == "services"
                                                         and item.text.startswith("~/"))}
    assert granted == listed
