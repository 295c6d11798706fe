# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter`."""

from stack_counter.cli.main import main

__all__ = ["main"]
