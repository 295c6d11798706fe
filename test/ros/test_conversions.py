# SPDX-License-Identifier: Apache-2.0
"""Core types survive the way through messages, every field of them."""

import dataclasses

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from stack_counter_msgs.msg import PosedImage
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from stack_counter_msgs.srv import StartScan

from stack_counter import geometry
from stack_counter.ros import conversions as convert
from stack_counter.ros.count_fields import to_visible_parts
from stack_counter.ros.part_fields import from_part_fields, to_part_fields
from stack_counter.ros.standard_messages import to_header, to_image, to_time
from stack_counter.ros.verdicts import set_verdict
from stack_counter.types import (
    CellFillingLevel,
    Container,
    FillingLevel,
    HeightMap,
    Intrinsics,
    KeyView,
    PartPose,
    PartRequest,
    RangeValue,
    Reason,
    SourceCount,
    StackCount,
    StackVolume,
    View,
    ViewTally,
    VisiblePart,
)

# Fields that no message carries: what only drawings and reports of the same process show.
NOT_SENT = {"Container": {"rings", "wall_shape", "inner_map"},
            "StackVolume": {"mesh", "volume_parts"}, "StackCount": {"distribution"}}
STAMP_NS = 1_700_000_000_123_456_789
PART = PartRequest("nut", 1e-6, (0.03, 0.02, 0.01))
REQUEST = PosedImage(scan_id="scan 1", **to_part_fields(PART),
                     header=to_header(STAMP_NS, "optical"))


def random_transform(seed):
    random = np.random.default_rng(seed)
    return geometry.pose(Rotation.random(random_state=seed).as_matrix(), random.normal(size=3))


def example_image(seed, *shape, high=255):
    return np.random.default_rng(seed).integers(0, high, shape, np.uint8)


def example_depth(seed):
    depth = np.random.default_rng(seed).uniform(0.3, 1, (4, 6)).astype(np.float32)
    depth[0, 0] = 0
    return depth


def example_heights(seed):
    heights = np.random.default_rng(seed).normal(0.1, 0.01, (5, 3)).astype(np.float32)
    heights[2, 1] = np.nan
    return heights


def example_cell(seed):
    random = np.random.default_rng(seed)
    return CellFillingLevel(tuple(random.random(2).tolist()), tuple(random.random(3).tolist()), *(
        RangeValue(*random.random(3).tolist()) for _ in range(2)), coverage=float(random.random()))


def example_visible_part(seed):
    """A part whose outline is in steps that single precision has."""
    random = np.random.default_rng(seed)
    return VisiblePart(random.random(3), random.integers(0, 999, (5, 3)) / 1024, 0.75, 0.5,
                       PartPose(random_transform(seed), 0.625))


def examples():
    """One object of every type that is sent; no field has its default value."""
    intrinsics = Intrinsics(6, 4, 610.5, 611.5, 2.5, 1.5, "plumb_bob",
                            (0.1, -0.2, 0.001, 0.002, 0.03))
    view = View(STAMP_NS, intrinsics, random_transform(1), example_image(2, 4, 6, 3),
                example_depth(3), example_image(4, 4, 6, high=3), "optical", True)
    container = Container("box", random_transform(5), (0.3, 0.2, 0.1), 0.004, 0.003)
    top = HeightMap(random_transform(6), 0.002, example_heights(7))
    key_view = KeyView(STAMP_NS + 1, intrinsics, random_transform(8), 5,
                       example_image(9, 4, 6, high=3), example_depth(10),
                       example_image(11, 4, 6, 3))
    tally = ViewTally(12, 10, {"no_tf": 1, "blurred": 1})
    volume = StackVolume(
        stamp_ns=STAMP_NS, stack_volume=1.25e-3, stack_volume_std=2e-5, container=container,
        fill_level=(0.1, 0.5, 1.2), coverage=0.87, top=top,
        inner=dataclasses.replace(top, heights=example_heights(12)), key_view=key_view,
        views=tally, reasons=(Reason.LOW_COVERAGE, Reason.ONE_SIDE), one_side=True,
        seconds={"finish": 0.25},
        missing_cameras=("left", "back"), region="bin_2", view_agreement_m=0.0012,
        resolution_m=0.0025, filling_level=FillingLevel(example_cell(1), (
            example_cell(2), example_cell(3)), (2, 1)))
    count = StackCount(
        count=412, count_interval=(391, 430), confidence=0.95, gamma=0.33, gamma_std=0.02,
        unit_volume=2e-6, volume=volume, estimator="network", status="degraded",
        reasons=(Reason.NO_DEPTH, Reason("of_a_newer_node")),
        gamma_shares={"estimator": 0.75, "piles": 0.25}, counted_scans=3, seconds={"gamma": 0.125},
        sources=(SourceCount("vision", 402, (380, 440), 0.2),
                 SourceCount("weight", 414, (412, 417), 0.8)), net_weight_kg=1.25,
        visible_parts=(example_visible_part(13), example_visible_part(14)))
    return {type(example).__name__: example for example in
            (intrinsics, view, container, top, key_view, tally, volume, count)}


def through_dds(message):
    return deserialize_message(serialize_message(message), type(message))


def received_posed_image(view):
    return convert.from_posed_image(through_dds(
        convert.to_posed_image(view, "base_link", "scan 1", PART, "left")))


def test_the_part_goes_from_the_view_to_the_volume():
    volume = convert.to_stack_volume(examples()["StackVolume"], "base_link", REQUEST, final=True)
    for message in (REQUEST, volume, StartScan.Request(**to_part_fields(PART))):
        assert from_part_fields(through_dds(message)) == PART


def received_volume(volume):
    return convert.from_stack_volume(through_dds(
        convert.to_stack_volume(volume, "base_link", REQUEST, final=True)))


def received_count(count):
    volume = convert.to_stack_volume(count.volume, "base_link", REQUEST, final=True)
    message = through_dds(convert.to_stack_count(count, volume))
    return convert.from_stack_count(message, convert.from_stack_volume(volume))


SEND = {
    "Intrinsics": lambda k: received_posed_image(
        dataclasses.replace(examples()["View"], intrinsics=k)).intrinsics,
    "View": received_posed_image,
    "Container": lambda c: convert.from_container(through_dds(convert.to_container(c))),
    "HeightMap": lambda m: convert.from_height_map(through_dds(convert.to_height_map(m))),
    "KeyView": lambda v: convert.from_key_view(through_dds(convert.to_key_view(v, "optical"))),
    "ViewTally": lambda t: convert.from_tally(through_dds(convert.to_tally(t))),
    "StackVolume": received_volume,
    "StackCount": received_count,
}


def assert_same(received, sent, name):
    """Compares two values, dataclasses field by field but for those that are not sent."""
    assert type(received) is type(sent), name
    if dataclasses.is_dataclass(sent):
        for field in dataclasses.fields(sent):
            if field.name not in NOT_SENT.get(type(sent).__name__, ()):
                assert_same(getattr(received, field.name), getattr(sent, field.name),
                            f"{name}.{field.name}")
    elif isinstance(sent, tuple):
        assert len(received) == len(sent), name
        for one, other in zip(received, sent):
            assert_same(one, other, name)
    elif isinstance(sent, np.ndarray):
        assert received.dtype == sent.dtype, name
        np.testing.assert_allclose(received, sent, rtol=0, atol=1e-12, err_msg=name)
    else:
        assert received == sent, name


@pytest.mark.parametrize("name", SEND)
def test_every_field_of_a_type_arrives(name):
    example = examples()[name]
    assert_same(SEND[name](example), example, name)


@pytest.mark.parametrize("name", SEND)
def test_no_field_of_an_example_has_its_default(name):
    """A field that is added and not filled in here would arrive as it left without being sent."""
    example = examples()[name]
    for field in dataclasses.fields(example):
        if field.name not in NOT_SENT.get(name, ()):
            default = field.default_factory() \
                if field.default_factory is not dataclasses.MISSING else field.default
            value = getattr(example, field.name)
            assert isinstance(value, np.ndarray) or value != default, f"{name}.{field.name}"


def test_what_is_not_sent_is_a_field():
    for name, fields in NOT_SENT.items():
        assert fields <= {field.name for field in dataclasses.fields(examples()[name])}


def test_a_field_that_is_not_sent_is_noticed(monkeypatch):
    example = dataclasses.replace(examples()["StackVolume"], mesh="a mesh")
    monkeypatch.delitem(NOT_SENT, "StackVolume")
    with pytest.raises(AssertionError, match="StackVolume.mesh"):
        assert_same(received_volume(example), example, "StackVolume")


def test_view_without_images_stays_without():
    view = dataclasses.replace(examples()["View"], color=None, depth=None, labels=None)
    received = received_posed_image(view)
    assert received.color is received.depth is received.labels is None


def test_volume_without_maps_and_key_view_stays_without():
    volume = dataclasses.replace(examples()["StackVolume"], top=None, inner=None, key_view=None,
                                 filling_level=None)
    received = received_volume(volume)
    assert received.top is received.inner is received.key_view is received.filling_level is None


def test_a_count_without_a_weight_stays_without():
    count = dataclasses.replace(examples()["StackCount"], net_weight_kg=None)
    assert received_count(count).net_weight_kg is None


@pytest.mark.parametrize("parts", [None, ()])
def test_parts_that_were_not_looked_for_are_told_from_none_that_show(parts):
    count = dataclasses.replace(examples()["StackCount"], visible_parts=parts)
    assert received_count(count).visible_parts == parts


def test_a_part_without_a_pose_stays_without():
    part = dataclasses.replace(example_visible_part(13), pose=None)
    count = dataclasses.replace(examples()["StackCount"], visible_parts=(part,))
    assert received_count(count).visible_parts[0].pose is None


def test_parts_that_show_have_places_of_their_own_in_the_message():
    volume = convert.to_stack_volume(examples()["StackVolume"], "base_link", REQUEST, final=True)
    count = convert.to_stack_count(examples()["StackCount"], volume)
    message = through_dds(to_visible_parts(count))
    assert [part.id for part in message.parts] == ["0", "1"] and count.visible_count == 2
    assert (message.scan_id, message.header.frame_id) == ("scan 1", "base_link")
    outline = examples()["StackCount"].visible_parts[0].outline
    size = message.parts[0].size
    assert [size.x, size.y] == np.ptp(outline[:, :2], axis=0).tolist()
    failed = convert.failed_count("dark", volume)
    assert failed.visible_count == -1 and not failed.visible_parts


def test_a_volume_is_sent_with_what_its_scan_asked_for():
    volume = examples()["StackVolume"]
    message = convert.to_stack_volume(volume, "base_link", REQUEST, final=True)
    assert (message.scan_id, message.part, message.unit_volume) == ("scan 1", "nut", 1e-6)
    assert message.final and message.overfilled and message.header.frame_id == "base_link"
    assert message.key_view.header.frame_id == "optical"
    count = convert.to_stack_count(examples()["StackCount"], message)
    assert (count.scan_id, count.part, count.final) == ("scan 1", "nut", True)
    assert (count.stack_volume, count.stack_volume_std) == (1.25e-3, 2e-5)
    assert (count.container, count.views, count.missing_cameras) == (
        message.container, message.views, message.missing_cameras)
    assert count.overfilled and count.cells_filling_levels == message.cells_filling_levels
    assert (count.overall_filling_level, count.filling_level_cell_count) == (
        message.overall_filling_level, message.filling_level_cell_count)


def test_failed_count_says_why():
    message = convert.failed_count("0 views", StackVolumeMsg(scan_id="s", error="0 views"))
    assert message.status == StackCountMsg.STATUS_ERROR and message.error == "0 views"
    assert np.isnan(message.gamma)


@pytest.mark.parametrize("expected, verdict, text", [
    (0, StackCountMsg.VERDICT_NONE, "412 parts, 90% sure between 391 and 430"),
    (410, StackCountMsg.VERDICT_PASS, "PASS: 412 parts, 90% sure between 391 and 430; all of it "
                                      "within 410 +- 20"),
    (500, StackCountMsg.VERDICT_FAIL, "FAIL: 412 parts, 90% sure between 391 and 430; none of it "
                                      "within 500 +- 20"),
    (400, StackCountMsg.VERDICT_UNSURE, "UNSURE: 412 parts, 90% sure between 391 and 430; it "
                                        "straddles 400 +- 20")])
def test_verdict_is_set_and_explained(expected, verdict, text):
    message = StackCountMsg(count=412, count_low=391, count_high=430, confidence=0.9)
    assert set_verdict(message, expected, 20) == text
    assert message.verdict == verdict


def test_image_bytes_are_taken_as_they_are():
    image = np.asfortranarray(np.arange(12, dtype=np.uint16).reshape(3, 4))
    message = to_image(image, "16UC1", to_header(0, "f"))
    assert (message.height, message.width, message.step) == (3, 4, 8)
    assert bytes(message.data) == np.ascontiguousarray(image).tobytes()


@pytest.mark.parametrize("stamp", [0, 999_999_999, 10**9, 1_700_000_000_999_999_999])
def test_stamps(stamp):
    time = to_time(stamp)
    assert time.sec * 10**9 + time.nanosec == stamp
