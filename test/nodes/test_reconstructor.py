"""The reconstructor over real DDS."""

import json

import pytest
from analytic import Scene
from harness import LATCHED
from painted import marks, painted, unlabelled
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from stack_counter_msgs.msg import PosedImage, ScanStatus, StackVolume

from stack_counter.nodes.conversions import to_posed_image

SPACE = "/stack_counter"


@pytest.fixture
def reconstructor(ros):
    ros.start("reconstructor")
    images = ros.node.create_publisher(PosedImage, f"{SPACE}/posed_images", QoSProfile(depth=100))
    status = ros.node.create_publisher(ScanStatus, f"{SPACE}/scan_status", QoSProfile(depth=100))
    ros.matched(images, status)
    volumes = ros.listen(StackVolume, f"{SPACE}/volume", LATCHED)

    def scan(views, name, announced=None):
        done = len(volumes)
        for view in views:
            images.publish(to_posed_image(view, "base_link", name, "nut", 1e-6))
        stop = ScanStatus(node="collector", scan_id=name, state=ScanStatus.STOPPED,
                          received=len(views) + 1, skip_reasons=["blurred"], skip_counts=[1],
                          processed=len(views) if announced is None else announced)
        stop.header.frame_id = "base_link"
        status.publish(stop)
        ros.wait(lambda: len(volumes) > done, f"the volume of scan {name}")
        assert volumes[-1].scan_id == name
        return volumes[-1]

    return scan


def test_volume_of_a_box_is_right_and_the_next_scan_starts_anew(reconstructor):
    box = Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3)
    first = reconstructor(box.views(6), "one")
    assert first.final and not first.error
    assert first.stack_volume == pytest.approx(0.2 * 0.15 * 0.06, rel=0.03)
    assert (first.views.received, first.views.used) == (7, 6)
    assert list(first.views.skip_reasons) == ["blurred"]
    assert first.header.frame_id == "base_link" and first.header.stamp.sec == 5
    low = Scene().box([0, 0, 0.015], [0.2, 0.15, 0.03])
    second = reconstructor(low.views(6), "one")  # a name used twice is no reason to add up
    assert second.stack_volume == pytest.approx(0.2 * 0.15 * 0.03, rel=0.04)


def test_too_few_views_say_so_and_lost_ones_are_named(reconstructor):
    box = Scene().box([0.0, 0.0, 0.03], [0.2, 0.15, 0.06])
    few = reconstructor(box.views(2), "few")
    assert "2 views used" in few.error and "expected at least 3" in few.error
    lost = reconstructor(box.views(4), "lost", announced=5)
    # A block with walls so smooth may as well be a full bin.
    assert list(lost.reasons) == ["container_unsure", "views_lost"]


def test_prompts_by_the_parameter_service_hold_from_the_next_scan_on(ros, reconstructor):
    def set_prompts(document):
        value = Parameter("prompts", value=json.dumps(document)).to_parameter_msg()
        return ros.call(SetParameters, f"{SPACE}/reconstructor/set_parameters",
                        SetParameters.Request(parameters=[value])).results[0]

    views = painted(depth=False)
    assert "no_depth" in reconstructor(unlabelled(views), "plain").error
    bad = set_prompts({"part": {}})
    assert not bad.successful and "unknown key 'part'" in bad.reason
    assert set_prompts(marks(views[0].labels)).successful
    volume = reconstructor(unlabelled(views), "marked")
    assert not volume.error and volume.has_key_view
