"""`make lint`: size, layout and words of the whole checkout, in one process."""

import sys

from tests.style import layout, pages, tokens, words


def main() -> int:
    """The exit status; prints a line for each problem."""
    said = [line for check in (tokens, layout, words, pages) for line in check.problems()]
    print("\n".join(said) or "size, layout and words: as they should be")
    return int(any(not line.startswith("warning: ") for line in said))


if __name__ == "__main__":
    sys.exit(main())
