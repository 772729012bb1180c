"""Damage of a run file: a lost end, parts that are broken, missing or there twice.

A file that was killed is readable to its last flush, and its end is missing: `recover` makes a whole file of it, which
is a shorter run and no damaged one. A hole within a run stays one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.findings import Damage
from daq.runs.mcap_scan import Scan

CUT = "its end is missing: the file was cut off (a crash, a full disk, a copy that was interrupted)"


def damage_of(scan: Scan, messages: int, unreadable: int, imu: NDArray[np.void]) -> tuple[Damage, ...]:
    """One for each fault of a file that was scanned to its end.

    `messages` is how many it gave, `unreadable` how many of them are not of their topic's form, `imu` (n,) the samples,
    whose running count tells what is missing even where the file's own count is.
    """
    found = [] if scan.complete else [Damage("cut", CUT)]
    found += holes(scan, messages)
    if unreadable:
        found.append(Damage("form", f"{unreadable} messages are not of their topic's form"))
    if imu.size:
        steps = np.diff(imu["index"].astype(np.int64))
        missing, twice = int((steps[steps > 1] - 1).sum()), imu.size - np.unique(imu).size
        if missing:
            found.append(Damage("imu_missing", f"{missing} IMU samples are missing by their running count"))
        if twice:
            found.append(Damage("imu_twice", f"{twice} IMU samples are there twice"))
    return tuple(found)


def holes(scan: Scan, messages: int) -> list[Damage]:
    """Missing or broken parts within the file, by its check sums and its own count of messages."""
    found = []
    if scan.damaged_chunks:
        found.append(Damage("check_sum", f"{scan.damaged_chunks} damaged chunks left out, their check sums are wrong"))
    found += [Damage("check_sum", f"the check sum of {name} inside it is wrong") for name in scan.damaged_files]
    if scan.complete and scan.written is not None and scan.written != messages:
        lacks = scan.written - messages
        found.append(Damage("messages", f"{lacks} of {scan.written} messages are missing" if lacks > 0 else
                            f"{-lacks} messages more than the {scan.written} that were written: a part is there twice"))
    return found
