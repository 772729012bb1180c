"""CSV files packed with gzip, a column of which is spoilt."""

import gzip
from pathlib import Path


def stuck(source: Path, target: Path) -> None:
    """A copy whose column reads the same everywhere."""
    header, *rows = (line.split(",") for line in gzip.decompress(source.read_bytes()).decode().splitlines())
    k = header.index("q2_rad")
    lines = [header, *([*row[:k], "0.3", *row[k + 1 :]] for row in rows)]
    target.write_bytes(gzip.compress("\n".join(map(",".join, lines)).encode()))
