# SPDX-License-Identifier: Apache-2.0
"""Poses of parts in ten bytes each: the form in which scenes are stored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_POSITION_STEPS, _COMPONENT_STEPS = 65535, 1023  # of the format: 16 and 10 bits
_ROUNDS_TO_REPEAT = 6  # of decoding and encoding, after which every code repeats itself


@dataclass(frozen=True, eq=False)
class PackedPoses:
    """Poses of n parts as a shard stores them.

    Attributes:
        frame: (6,) float32, lowest corner and extent of the positions, metres.
        positions: (n, 3) uint16 in 65,535ths of the extent.
        turns: (n,) uint32: the index of the largest quaternion component (2 bits), and the other
            three in 1,023rds of their range of +-1/sqrt(2) (10 bits each); within 0.22 degrees.
    """

    frame: np.ndarray
    positions: np.ndarray
    turns: np.ndarray


def pack_poses(poses: np.ndarray) -> PackedPoses:
    """Packs poses in ten bytes each; what `unpack_poses` gave is packed as it was.

    Args:
        poses: (n, 7) float64 positions in metres and unit quaternions (x, y, z, w).
    """
    # Positions: shares of the box that they span
    low = poses[:, :3].min(axis=0, initial=np.inf) if len(poses) else np.zeros(3)
    extent = np.maximum(poses[:, :3].max(axis=0) - low, 1e-6) if len(poses) else np.ones(3)
    frame = np.concatenate([low, extent]).astype(np.float32)
    share = (poses[:, :3] - frame[:3]) / frame[3:]
    positions = np.round(np.clip(share, 0, 1) * _POSITION_STEPS).astype(np.uint16)
    # Where two components are nearly alike, rounding may make the other one the largest: two
    # codes then give each other. Of such a pair the smaller one stands for both.
    turns = _encode_quaternions(poses[:, 3:])
    for _ in range(_ROUNDS_TO_REPEAT):
        turns = _encode_quaternions(_decode_quaternions(turns))
    return PackedPoses(frame, positions,
                       np.minimum(turns, _encode_quaternions(_decode_quaternions(turns))))


def unpack_poses(packed: PackedPoses) -> np.ndarray:
    """(n, 7) float64 positions in metres and unit quaternions (x, y, z, w)."""
    frame = packed.frame.astype(float)
    positions = frame[:3] + packed.positions / _POSITION_STEPS * frame[3:]
    return np.concatenate([positions, _decode_quaternions(packed.turns)], axis=1)


def _encode_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """(n,) uint32 codes of (n, 4) unit quaternions (x, y, z, w)."""
    largest = np.argmax(np.abs(quaternions), axis=1)
    # q and -q are the same rotation: the largest component is made positive and left out.
    sign = np.where(np.take_along_axis(quaternions, largest[:, None], 1) < 0, -1, 1)
    others = (quaternions * sign)[np.arange(4) != largest[:, None]].reshape(-1, 3)
    shares = np.clip(others * np.sqrt(0.5) + 0.5, 0, 1)
    steps = np.round(shares * _COMPONENT_STEPS).astype(np.uint32)
    return (largest.astype(np.uint32) << 30) | (steps[:, 0] << 20) | (steps[:, 1] << 10) \
        | steps[:, 2]


def _decode_quaternions(codes: np.ndarray) -> np.ndarray:
    """(n, 4) float64 unit quaternions (x, y, z, w) of (n,) uint32 codes."""
    largest = (codes >> 30).astype(int)
    steps = np.stack([codes >> 20, codes >> 10, codes], axis=1) & 1023
    others = (steps / _COMPONENT_STEPS - 0.5) * np.sqrt(2)
    quaternions = np.empty((len(codes), 4))
    quaternions[np.arange(4) != largest[:, None]] = others.ravel()
    # The largest component follows from the unit length.
    quaternions[np.arange(len(quaternions)), largest] = np.sqrt(
        np.maximum(1 - np.sum(others**2, axis=1), 0))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
