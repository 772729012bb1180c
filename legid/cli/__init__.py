"""The `legid` command line."""

from legid.cli.main import TRACEBACK, main

__all__ = ["TRACEBACK", "main"]
