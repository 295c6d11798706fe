# SPDX-License-Identifier: Apache-2.0
"""bfloat16 only where the processor has instructions for it."""

import pytest
import torch

from stack_counter.train.device import mixed_precision


@pytest.mark.parametrize("has_bfloat16, dtype", [(True, torch.bfloat16), (False, torch.float32)])
def test_the_precision_follows_the_processor(has_bfloat16, dtype, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": has_bfloat16})
    with mixed_precision(torch.device("cpu")):
        assert torch.nn.Linear(2, 2)(torch.zeros(1, 2)).dtype == dtype


def test_a_processor_that_says_nothing_computes_in_float32(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    with mixed_precision(torch.device("cpu")):
        assert torch.nn.Linear(2, 2)(torch.zeros(1, 2)).dtype == torch.float32
