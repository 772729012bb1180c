"""The `legid` command line."""

from experiments.cli.main import TRACEBACK, main

__all__ = ["TRACEBACK", "main"]
