"""`python -m tests.kernel`: the kernel tests with everything that they can use, their output, and their wall time."""

import sys

from tests.kernel import build_module, uml


def main(tests: list[str]) -> int:
    """Status of the tests; 0 with a reason where there is no kernel to be had."""
    try:
        base = uml.prepare()
        try:
            build_module.build(base)
        except uml.Unavailable as error:
            print(f"without the kernel's own I2C core, through CUSE only: {error}")
        outcome = uml.run(tests)
    except uml.Unavailable as error:
        print(f"kernel tests skipped: {error}")
        return 0
    print(outcome.output)
    print(outcome)
    return outcome.status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
