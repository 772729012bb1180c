"""The one door to the programs that measure.

    python -m evidence                        # what there is, and how long it takes
    python -m evidence NAME [ARGUMENT ...]    # run one: soak, imu-links, blind.causes
    python -m evidence --index                # docs/evidence/index.md anew
"""

import importlib
import sys
import time

from evidence.kept import found_again
from evidence.registry import INDEX, PACKAGE, evidence, index


def main(arguments: list[str]) -> int:
    """Run, list or index; the exit status."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__)
        for name, measured in evidence().items():
            for one in measured:
                print(f"{name:20} {one.minutes:5g} min  {one.what}  ({one.command}; resumes: {one.resumes})")
        return 0
    name, *rest = arguments
    if name == "--index":
        INDEX.write_text(index(), encoding="utf-8")
        return 0
    try:
        module = importlib.import_module(f"{PACKAGE}.{name.replace('-', '_')}")
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith(PACKAGE):
            raise
        print(f"{name}: no program of that name; `python -m {PACKAGE}` lists them", file=sys.stderr)
        return 2
    if not hasattr(module, "main"):
        print(f"{name}: is a part of other programs; `python -m {PACKAGE}` lists those that run", file=sys.stderr)
        return 2
    sys.argv[:] = [f"python -m {PACKAGE} {name}", *rest]
    began = time.monotonic()
    status = module.main(rest)
    print(f"{name}: {(time.monotonic() - began) / 60:.1f} minutes", file=sys.stderr)
    if found_again:
        print(f"{name}: {len(found_again)} pieces are of an earlier call; rm -r build/evidence measures them anew",
              file=sys.stderr)
    return int(status or 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
