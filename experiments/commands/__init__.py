"""The commands of `legid`, one module each: `add_parser(subparsers)` describes it, `run(args)` does it.

A module imports nothing heavy before `run`: `legid --help` answers at once.
"""

COMMANDS = ("demo", "record", "calibrate", "info", "recover", "export", "fit", "validate", "diagnose", "effects",
            "simulate", "casebook", "monte_carlo", "doctor",
            "runs", "init", "excite", "emulate", "live")
"""Module names, in the order in which `legid --help` lists them."""
