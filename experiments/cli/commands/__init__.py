"""The commands of `legid`, one module each: `add_parser(subparsers)` describes it, `run(args)` does it.

A module imports nothing heavy before `run`: `legid --help` answers at once.
"""
