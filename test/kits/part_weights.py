# SPDX-License-Identifier: Apache-2.0
"""A file of a network that finds parts by a rule: what stands up is a part, its summit the middle.

It is right for parts of about a part length that lie apart.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from safetensors.numpy import save_file

from stack_counter.inference import GRAPH
from stack_counter.occupancy.maps import CHANNELS
from stack_counter.visible_parts.decoding import MIDDLE, OUTPUTS, SHARE, SHOWN
from stack_counter.visible_parts.finder import FORMAT

HEIGHT = 3  # channel: log of the height over the inner surface
SHARE_TOLD = 0.8
_SIDE = 9  # of the window that is averaged for the heat map, pixels


def write_part_weights(path, threshold=0.5):
    """Writes the file and returns its path."""
    weight = np.zeros((OUTPUTS, CHANNELS, _SIDE, _SIDE), np.float32)
    bias = np.zeros(OUTPUTS, np.float32)
    weight[SHOWN, HEIGHT, _SIDE // 2, _SIDE // 2], bias[SHOWN] = 40, -4
    distance = np.hypot(*(np.indices((_SIDE, _SIDE)) - _SIDE // 2))
    weight[MIDDLE, HEIGHT], bias[MIDDLE] = np.exp(-(distance / 2.5) ** 2 / 2), -6
    bias[SHARE] = np.log(SHARE_TOLD / (1 - SHARE_TOLD))
    shape = ["batch", "channels", "rows", "cols"]
    graph = helper.make_graph(
        [helper.make_node("Conv", ["maps", "weight", "bias"], ["out"], pads=[_SIDE // 2] * 4)],
        "rule", [helper.make_tensor_value_info("maps", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, shape)],
        [numpy_helper.from_array(weight, "weight"), numpy_helper.from_array(bias, "bias")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    save_file({GRAPH: np.frombuffer(model.SerializeToString(), np.uint8)}, path,
              metadata={"format": FORMAT, "threshold": str(threshold)})
    return path
