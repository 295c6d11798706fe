# SPDX-License-Identifier: Apache-2.0
"""Messages, services and actions: they import, and each field has its meaning beside it."""

from pathlib import Path

import pytest

MSG_DEFS = Path(__file__).parent.parent / "msg_defs"
DEFINITIONS = sorted(path for kind in ("msg", "srv", "action")
                     for path in (MSG_DEFS / kind).glob(f"*.{kind}"))


def undocumented(definition: str) -> list[str]:
    """Fields and constants of a definition that no comment stands above or beside."""
    missing, comment_above = [], False
    for line in definition.splitlines():
        text = line.strip()
        if not text or text == "---":
            comment_above = False
        elif text.startswith("#"):
            comment_above = True
        else:
            if not comment_above and "#" not in text:
                missing.append(text)
            comment_above = False
    return missing


def test_definitions_are_found():
    assert len(DEFINITIONS) == 21


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda path: path.name)
def test_every_field_is_documented(path):
    assert undocumented(path.read_text()) == []


def test_a_bare_field_is_noticed():
    assert undocumented("# a [m]\nfloat64 a\nfloat64 b\n---\nbool c  # c\n") == ["float64 b"]


@pytest.mark.parametrize("path", DEFINITIONS, ids=lambda path: path.name)
def test_generated_code_imports_and_has_the_fields(path):
    package = pytest.importorskip(f"stack_counter_msgs.{path.suffix[1:]}")
    interface = getattr(package, path.stem)
    parts = path.read_text().split("\n---\n")
    classes = {1: ["self"], 2: ["Request", "Response"], 3: ["Goal", "Result", "Feedback"]}
    for name, text in zip(classes[len(parts)], parts):
        message = interface() if name == "self" else getattr(interface, name)()
        declared = [line.split()[1] for line in text.splitlines()
                    if line.strip() and not line.startswith("#") and "=" not in line]
        fields = list(message.get_fields_and_field_types())
        assert [field for field in fields if field != "structure_needs_at_least_one_member"] \
            == declared


def test_constants():
    msg = pytest.importorskip("stack_counter_msgs.msg")
    count, scan = msg.StackCount, msg.ScanStatus
    assert (count.STATUS_OK, count.STATUS_DEGRADED, count.STATUS_ERROR) == (0, 1, 2)
    assert (count.VERDICT_NONE, count.VERDICT_PASS, count.VERDICT_FAIL, count.VERDICT_UNSURE) \
        == (0, 1, 2, 3)
    assert (scan.IDLE, scan.SCANNING, scan.STOPPED) == (0, 1, 2)


def test_tf_message_is_the_real_ones_shape():
    tf2_msgs = pytest.importorskip("tf2_msgs.msg")
    assert tf2_msgs.TFMessage().get_fields_and_field_types() == {
        "transforms": "sequence<geometry_msgs/TransformStamped>"}
