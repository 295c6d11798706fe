# SPDX-License-Identifier: Apache-2.0
"""The device that trains networks, and the precision in which it is fastest."""

from __future__ import annotations

import torch


def training_device() -> torch.device:
    """The accelerator that torch finds, or the CPU."""
    return torch.accelerator.current_accelerator(check_available=True) or torch.device("cpu")


def mixed_precision(device: torch.device) -> torch.autocast:
    """Context in which a network computes in bfloat16, where the device has instructions for it.

    Processors without them emulate it: a step that takes 1 s in float32 then takes 11 s.
    """
    has_bfloat16 = device.type != "cpu" or torch.cpu.get_capabilities().get("avx512_bf16", False)
    return torch.autocast(device.type, torch.bfloat16, enabled=has_bfloat16)
