# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter`."""

try:
    from stack_counter.cli.main import main
except KeyboardInterrupt:  # Ctrl-C while libraries load, which takes seconds on a busy machine
    raise SystemExit(130) from None

__all__ = ["main"]
