# SPDX-License-Identifier: Apache-2.0
"""`python -m stack_counter` is `stack-counter`."""

import sys

from stack_counter.cli import main

sys.exit(main())
