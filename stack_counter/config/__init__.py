# SPDX-License-Identifier: Apache-2.0
"""Settings of the three nodes: what they are, and the files that hold them."""

from stack_counter.config.sections import (
    SETTING_NAMES,
    CollectorConfig,
    Config,
    CounterConfig,
    ReconstructorConfig,
    Section,
    load_config,
    read_parameters,
    to_ros_parameters,
)
from stack_counter.config.setting_fields import build_section

__all__ = [
    "SETTING_NAMES",
    "CollectorConfig",
    "Config",
    "CounterConfig",
    "ReconstructorConfig",
    "Section",
    "build_section",
    "load_config",
    "read_parameters",
    "to_ros_parameters",
]
