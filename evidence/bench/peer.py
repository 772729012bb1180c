"""One peer on one length of the record, in a process of its own: prints what it found as lines of JSON.

    python -m evidence bench.peer PEER RECORD.npz SAMPLES LIMIT_S
"""

import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evidence.bench.record import Recorded, pose, read_record

PEERS = ("legid", "casadi", "mujoco", "mujoco-2ms", "free", "paper")
DEFAULT_STEP_S = 0.002
"""MuJoCo's own (XML reference, option/timestep)."""


def run(peer: str, recorded: Recorded, limit_s: float) -> dict[str, Any]:
    if peer == "legid":
        from evidence.bench.own import solve

        return solve(recorded)
    if peer == "free":
        from evidence.bench.own import solve_free

        return solve_free(recorded)
    if peer == "casadi":
        from evidence.bench import casadi_ipopt

        found = casadi_ipopt.solve(pose(recorded))
        return {"seconds": found.build_s + found.solve_s, "build_s": found.build_s, "solve_s": found.solve_s,
                "iterations": found.iterations, "beta": found.beta.tolist()}
    if peer.startswith("mujoco"):
        from evidence.bench import mujoco_sysid

        by = mujoco_sysid.solve(recorded, DEFAULT_STEP_S if peer == "mujoco-2ms" else 1.0 / recorded.data.rate_hz)
        return {"seconds": by.seconds, "beta": by.beta.tolist()}
    from evidence.bench import paper

    return paper.solve(recorded, tell, limit_s)


def tell(found: dict[str, Any]) -> None:
    print(json.dumps(found), file=sys.__stdout__, flush=True)


def main(arguments: Sequence[str]) -> None:
    """Run one; what it found is a line of JSON."""
    name, path, samples, limit = arguments
    with contextlib.redirect_stdout(sys.stderr):  # toolboxes print
        done = run(name, read_record(Path(path), int(samples)), float(limit))
    tell(done)
