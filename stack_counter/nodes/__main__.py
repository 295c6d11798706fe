# SPDX-License-Identifier: Apache-2.0
"""`python -m stack_counter.nodes NAME` runs a node, and ends without a word if Ctrl-C is early."""

import sys
from importlib import import_module

if __name__ == "__main__":
    try:
        from stack_counter.ros.processes import NODES

        name = sys.argv[1] if len(sys.argv) > 1 else ""
        if name not in NODES:
            print(f"python -m stack_counter.nodes: no node '{name}'; expected one of "
                  f"{', '.join(NODES)}", file=sys.stderr)
            sys.exit(2)
        import_module(f"stack_counter.nodes.{name}").main()
    except KeyboardInterrupt:  # while libraries load, which takes seconds on a busy machine
        sys.exit(130)
