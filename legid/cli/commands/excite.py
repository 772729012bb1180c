"""`legid excite`: design a torque plan, or a session of them."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import legid
from daq import InputError
from experiments import excite
from experiments.console import stages
from legid.cli.arguments import FORCE, RIG_ALONE, number
from legid.cli.command import Command, argument, one_of, output

if TYPE_CHECKING:
    from collections.abc import Callable

    from daq import Rig
    from daq.recording import Plan


def _within(low: float, high: float) -> Callable[[str], float]:
    return number(lambda value: low <= value <= high, f"a number from {low:g} to {high:g}")


COMMAND = Command(
    "excite", "design an excitation within the rig's limits",
    "Optimise a torque plan for the information about all parameters, with a prior model of the rig: a Fourier series "
    "of odd harmonics, with free amplitudes and phases. The simulated motion stays within the rig's limits, with a "
    "margin. With --session a whole session: several realisations at two amplitudes, slow ramps with holds, free "
    "swings, or what the causes of a diagnosis call for. Without a model, a plain multisine of --peak: what the motion "
    "will be is then unknown, so begin gently.", (
        RIG_ALONE,
        argument("--model", metavar="MODEL.json", help="prior model, from an earlier fit"),
        argument("--holds", metavar="N", type=_within(2, 20),
                 help="a staircase of N torques to either side of zero instead, up and down, with a hold on each: for "
                      "legid calibrate shunt --weight"),
        argument("--peak", metavar="NM", type=_within(1e-6, 1e6),
                 help="without --model: largest torque; default: a tenth of the rig's limit"),
        one_of(output("--out", "plan", "PLAN", help="one torque plan to write (CSV)"),
               argument("--session", metavar="DIR", help="folder for the plans of a session and their index"),
               required=True),
        FORCE,
        argument("--next", metavar="DIAGNOSIS.json",
                 help="with --session: plans that show the causes of this diagnosis best"),
        argument("--runs", type=_within(4, 64), default=16,
                 help="with --session: number of plans (default 16: every part of a diagnosis sees every kind)"),
        argument("--criterion", choices=("d", "worst"), default="d",
                 help="what is made small. d: the mean and the largest of the relative standard errors, both as "
                      "logarithms; worst: the largest alone (default d)"),
        argument("--seconds", type=_within(2.0, 600.0), default=20.0, help="length of a plan (default 20)"),
        argument("--low", metavar="HZ", type=_within(0.0, 25.0),
                 help="lowest frequency (default: one period a plan; 0.1 without a model)"),
        argument("--high", metavar="HZ", type=_within(0.0, 25.0), default=3.0, help="highest frequency (default 3)"),
        argument("--margin", type=_within(0.05, 1.0), default=0.8, help="share of each limit used (default 0.8)"),
        argument("--doubt", type=_within(0.0, 0.5), default=0.1,
                 help="share by which the prior's parameters may be off: models so far away keep the limits too "
                      "(default 0.1)"),
        argument("--tries", type=_within(1, 1000), default=2, help="random starts for each plan (default 2)"),
        argument("--steps", type=_within(1, 10_000), default=80,
                 help="steps of the optimiser from each start (default 80)"),
        argument("--seed", type=int, default=0, help="of the random draws (default 0)")))


def run(args: argparse.Namespace) -> int:
    """Design, write, tell."""
    from experiments.rig import rig_path

    args.rig = str(rig_path(args.rig))
    rig = legid.load_rig(args.rig)
    _check(args)
    if args.session is not None:
        return _session(args, rig)
    plan = _designed(args, rig)
    legid.write_plan(plan, args.out)
    print(f"{args.out}: {plan.duration_s:.1f} s, at most {plan.peak_nm:.3g} N m. "
          f"Next: legid record --rig {shlex.quote(args.rig)} --plan {shlex.quote(args.out)} --out RUN.mcap")
    return 0


def _check(args: argparse.Namespace) -> None:
    """Raises `InputError` for options that do not go together."""
    session, model = args.session is not None, bool(args.model)
    for wrong, error in (
            (args.seed < 0, ("--seed", f"{args.seed} is negative", "give a number from 0 on")),
            (args.next is not None and not session,
             ("--next", "answers with a session of plans", "give --session DIR instead of --out")),
            (session and not model, ("--session", "is designed by a model of the rig", "give --model MODEL.json")),
            (args.peak is not None and model,
             ("--peak", "is for a plan without a model", "leave out --peak; --margin scales the plan")),
            (args.holds is not None and model and not session,
             ("--holds", "is a plan without a model", "leave out --model and --session"))):
        if wrong:
            raise InputError(*error)


def _session(args: argparse.Namespace, rig: Rig) -> int:
    """A folder of plans, told of."""
    choice = excite.usual_choice() if args.next is None else excite.next_choice(args.next)
    with stages("designing") as show:
        session = excite.plan_session(
            excite.Bench(legid.load_model(args.model), rig, args.model, args.doubt),
            excite.Band(args.seconds, args.low or 0.0, args.high),
            excite.Search(args.margin, args.criterion, int(args.tries), int(args.steps), args.seed), choice,
            int(args.runs), show)
    excite.write_session(session, Path(args.session), args.rig, args.model, args.margin)
    print(excite.session_text(session, Path(args.session)))
    return 0


def _designed(args: argparse.Namespace, rig: Rig) -> Plan:
    """The best plan by the prior model, told of on the way; without one equal sines, or a staircase."""
    with stages("designing") as show:
        found = legid.excite(
            rig, args.model, seconds=args.seconds, low_hz=args.low, high_hz=args.high, peak_nm=args.peak,
            holds=None if args.holds is None else int(args.holds), margin=args.margin, criterion=args.criterion,
            doubt=args.doubt, tries=int(args.tries), steps=int(args.steps), seed=args.seed,
            progress=lambda done, total: show(f"{done:.1f} of {total:g} starts", done / total))
    if args.model:
        print(found)
    return found.plan
