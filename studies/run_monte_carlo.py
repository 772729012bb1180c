"""The work of `legid monte-carlo`."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from experiments.console import command_line, work_bar, write_json
from experiments.provenance import origin_of
from experiments.reports import write_page
from experiments.workflows import choose_executor
from studies.biped3 import (
    CASES,
    FLOOR,
    PROTOCOLS,
    blocks,
    make_table,
    require_parquet,
    run_study,
    study_sections,
    study_summary,
    study_text,
    table_document,
    write_parquet,
)
from studies.machine import machine
from studies.walker import motor_mechanism


def run(args: argparse.Namespace) -> int:
    """Run what is missing, print the table, write what was asked for."""
    require_parquet()
    started = time.perf_counter()
    folder = Path(args.out)
    protocol = PROTOCOLS[args.protocol]
    work = blocks([CASES[number - 1] for number in args.cases], [*args.methods, FLOOR], args.runs, args.seed, protocol)
    with work_bar("fitting", sum(block.count for block in work), "run") as done:
        results = run_study(work, folder / "blocks", choose_executor(args.workers, args.cluster),
                            lambda block, count: done(count, f"case {block.case.number} {block.method}"))
    table = make_table(results, args.seed, protocol)
    wall_s = time.perf_counter() - started
    print(study_text(table, wall_s))
    here = machine()
    write_page(folder / "report.html", "Simulation study of the three-link walker", study_summary(table),
               study_sections(table, here, args.note))
    write_parquet(folder / "runs.parquet", results, motor_mechanism().names)
    if args.json:
        write_json(args.json, {**table_document(table, wall_s, here),
                               "provenance": origin_of(seed=args.seed, command=command_line())})
    print(f"\nreport: {folder / 'report.html'}\nall runs: {folder / 'runs.parquet'}")
    return 0
