# SPDX-License-Identifier: Apache-2.0
"""Folders in nerfstudio's format (transforms.json and images) become bags.

Source: nerfstudio, `nerfstudio/data/dataparsers/nerfstudio_dataparser.py`, and
`instant_ngp_dataparser.py` for the keys of Instant NGP and Blender.
"""

from stack_counter.bag.nerfstudio.scene import import_scene

__all__ = ["import_scene"]
