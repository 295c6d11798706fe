"""The command `stack-counter`."""

from stack_counter.cli.main import main

__all__ = ["main"]
