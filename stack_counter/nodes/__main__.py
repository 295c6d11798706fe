# SPDX-License-Identifier: Apache-2.0
"""`python -m stack_counter.nodes NAME` runs a node, and ends without a word if Ctrl-C is early."""

import sys
from importlib import import_module

if __name__ == "__main__":
    try:
        import_module(f"stack_counter.nodes.{sys.argv[1]}").main()
    except KeyboardInterrupt:  # while libraries load, which takes seconds on a busy machine
        sys.exit(130)
