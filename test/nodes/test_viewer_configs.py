# SPDX-License-Identifier: Apache-2.0
"""The files for RViz and Foxglove name what the nodes have: docs/interface.md, which is compared
with the running nodes, and the fields of the messages."""

import dataclasses
import json
import re
import typing
from pathlib import Path

import pytest
import yaml
from kits.interface_table import full, table

from stack_counter.ros.standard_messages import message_type

ROOT = Path(__file__).parents[2]
LATCHED = {"/stack_counter/surface", "/stack_counter/markers", "/stack_counter/count_marker"}
DISPLAYS = {"PointCloud2": "sensor_msgs/msg/PointCloud2", "Image": "sensor_msgs/msg/Image",
            "MarkerArray": "visualization_msgs/msg/MarkerArray"}
NAMESPACES = {"/stack_counter/markers": {"container", "region", "cameras", "surface"},
              "/stack_counter/count_marker": {"count", "visible_parts"}}


@pytest.fixture(scope="module")
def types():
    """Type by topic: what the nodes publish, and the cameras' topics that they take."""
    return {full(name): kind for _, how, name, kind in table()
            if how in ("publishes", "subscribes")}


@pytest.fixture(scope="module")
def rviz():
    return yaml.safe_load((ROOT / "config" / "stack_counter.rviz").read_text())[
        "Visualization Manager"]


@pytest.fixture(scope="module")
def foxglove():
    return json.loads((ROOT / "config" / "foxglove.json").read_text())


def panels(foxglove, kind):
    return [c for name, c in foxglove["configById"].items() if name.split("!")[0] == kind]


def field(path, types):
    """Type of the field that a message path such as /topic.a.b names."""
    topic, *names = path.split(".")
    kind = types[topic]
    for name in names:
        kind = message_type(kind).get_fields_and_field_types()[name]
    return kind


def test_rviz_shows_what_is_published_and_hears_what_is_latched(rviz, types):
    assert rviz["Global Options"]["Fixed Frame"] == "base_link"
    assert rviz["Views"]["Current"]["Class"] == "rviz_default_plugins/Orbit"
    shown = {}
    for display in rviz["Displays"]:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        assert display["Enabled"] is display["Value"] is True, display["Name"]
        if "Topic" not in display:
            assert kind in ("Grid", "TF")
            continue
        topic = display["Topic"]["Value"]
        shown[topic] = display
        assert types[topic] == DISPLAYS[kind]
        latched = (display["Topic"]["Durability Policy"], display["Topic"]["Reliability Policy"])
        assert latched == (("Transient Local", "Reliable") if topic in LATCHED
                           else ("Volatile", "Best Effort"))
        assert set(display.get("Namespaces", {})) == NAMESPACES.get(topic, set())
    assert set(shown) == LATCHED | {"/camera/color/image_raw"}
    assert shown["/stack_counter/surface"]["Color Transformer"] == "RGB8"


def test_foxglove_shows_what_is_published(foxglove, types):
    scene, = panels(foxglove, "3D")
    assert scene["followTf"] == "base_link"
    assert {t for t, c in scene["topics"].items() if c["visible"]} == LATCHED
    for panel in (scene, *panels(foxglove, "Image")):
        for topic, settings in panel["topics"].items():
            assert types[topic] in DISPLAYS.values()
            assert set(settings.get("namespaces", {})) <= NAMESPACES.get(topic, set())
    image, = panels(foxglove, "Image")
    assert types[image["imageMode"]["imageTopic"]] == "sensor_msgs/msg/Image"
    assert types[image["imageMode"]["calibrationTopic"]] == "sensor_msgs/msg/CameraInfo"
    summary, = panels(foxglove, "DiagnosticSummary")
    assert types[summary["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"


def test_foxglove_reads_fields_that_the_messages_have(foxglove, types):
    number, = panels(foxglove, "RawMessages")
    plot, = panels(foxglove, "Plot")
    status, = panels(foxglove, "Indicator")
    assert number["topicPath"] == "/stack_counter/result.count"
    assert [p["value"] for p in plot["paths"]] == [
        *(f"/stack_counter/result.{name}" for name in ("count", "count_low", "count_high")),
        "/stack_counter/running_count.count"]
    for path in (number["topicPath"], *(p["value"] for p in plot["paths"])):
        assert field(path, types) == "uint32"
    assert field(status["path"], types) == "uint8"
    kind = message_type(types["/stack_counter/result"])
    assert [int(rule["rawValue"]) for rule in status["rules"]] == [
        kind.STATUS_OK, kind.STATUS_DEGRADED, kind.STATUS_ERROR]


def test_every_foxglove_panel_has_its_place(foxglove):
    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(foxglove["layout"])) == sorted(foxglove["configById"])


def fields_of(classes):
    """Type of each field of these classes of the Foxglove SDK, by its name in a layout file."""
    return {re.sub("_(.)", lambda letter: letter[1].upper(), name): kind
            for known in classes for name, kind in typing.get_type_hints(known).items()}


def classes_in(kind):
    """Classes that a type names: of itself, its alternatives or its entries."""
    if dataclasses.is_dataclass(kind):
        return [kind]
    return [known for part in typing.get_args(kind) for known in classes_in(part)]


def unknown_keys(settings, classes):
    """Keys, with the way to them, that none of these classes of the SDK has."""
    known, unknown = fields_of(classes), []
    for key, value in settings.items():
        if key not in known:
            unknown.append(key)
            continue
        inner = classes_in(known[key])
        if isinstance(value, dict) and "dict[" in str(known[key]):
            value = list(value.values())
        for entry in value if isinstance(value, list) else [value]:
            if isinstance(entry, dict) and inner:
                unknown += [f"{key}.{name}" for name in unknown_keys(entry, inner)]
    return unknown


def test_every_foxglove_setting_is_one_that_the_app_has_today(foxglove):
    layouts = pytest.importorskip("foxglove.layouts")
    panel_classes = {"3D": layouts.ThreeDeeConfig, "Image": layouts.ImageConfig,
                     "RawMessages": layouts.RawMessagesConfig, "Plot": layouts.PlotConfig,
                     "Indicator": layouts.IndicatorConfig,
                     "DiagnosticSummary": layouts.DiagnosticsSummaryConfig}
    for name, settings in foxglove["configById"].items():
        assert unknown_keys(settings, [panel_classes[name.split("!")[0]]]) == [], name
    settings = {"scene": {"transforms": {"axisScale": 1}}, "layers": {"grid": {"size": 2, "a": 1}}}
    assert unknown_keys(settings, [layouts.ThreeDeeConfig]) == ["scene.transforms.axisScale",
                                                                "layers.a"]
