"""`legid excite`: design a torque plan, or a session of them."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from experiments.cli.arguments import add_force, add_output, add_rig

if TYPE_CHECKING:
    from daq import Rig
    from daq.recording import Plan
    from experiments.excite import Band, Bench, Search


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "excite", help="design an excitation within the rig's limits",
        description="Optimise a torque plan for the information about all parameters, with a prior model of the rig: a "
                    "Fourier series of odd harmonics, with free amplitudes and phases. The simulated "
                    "motion stays within the rig's limits, with a margin. With --session a whole session: several "
                    "realisations at two amplitudes, slow ramps with holds, free swings, or what the causes of a "
                    "diagnosis call for. Without a model, a plain multisine of --peak: what the motion will be is then "
                    "unknown, so begin gently.")
    add_rig(parser, runs=False)
    parser.add_argument("--model", metavar="MODEL.json", help="prior model, from an earlier fit")
    parser.add_argument("--holds", metavar="N", type=_Number(2, 20),
                        help="a staircase of N torques to either side of zero instead, up and down, with a hold on "
                             "each: for legid calibrate shunt --weight")
    parser.add_argument("--peak", metavar="NM", type=_Number(1e-6, 1e6),
                        help="without --model: largest torque; default: a tenth of the rig's limit")
    out = parser.add_mutually_exclusive_group(required=True)
    add_output(out, "--out", "plan", "PLAN", help="one torque plan to write (CSV)")
    out.add_argument("--session", metavar="DIR", help="folder for the plans of a session and their index")
    add_force(parser)
    parser.add_argument("--next", metavar="DIAGNOSIS.json",
                        help="with --session: plans that show the causes of this diagnosis best")
    parser.add_argument("--separate", metavar="DIAGNOSIS.json",
                        help="with --model and --out: the plan that tells the rivals of this diagnosis apart soonest, "
                             "and the seconds that it needs")
    parser.add_argument("--runs", type=_Number(4, 64), default=16,
                        help="with --session: number of plans (default 16: every part of a diagnosis sees every kind)")
    parser.add_argument("--criterion", choices=("d", "worst"), default="d",
                        help="what is made small. d: the mean and the largest of the relative standard errors, both as "
                             "logarithms; worst: the largest alone (default d)")
    parser.add_argument("--seconds", type=_Number(2.0, 600.0), default=20.0, help="length of a plan (default 20)")
    parser.add_argument("--low", metavar="HZ", type=_Number(0.0, 25.0),
                        help="lowest frequency (default: one period a plan; 0.1 without a model)")
    parser.add_argument("--high", metavar="HZ", type=_Number(0.0, 25.0),
                        help="highest frequency (default 3; --separate tries up to a twelfth of the sampling rate)")
    parser.add_argument("--margin", type=_Number(0.05, 1.0), default=0.8, help="share of each limit used (default 0.8)")
    parser.add_argument("--doubt", type=_Number(0.0, 0.5), default=0.1,
                        help="share by which the prior's parameters may be off: models so far away keep the limits too "
                             "(default 0.1)")
    parser.add_argument("--tries", type=_Number(1, 1000), default=2, help="random starts for each plan (default 2)")
    parser.add_argument("--steps", type=_Number(1, 10_000), default=80,
                        help="steps of the optimiser from each start (default 80)")
    parser.add_argument("--seed", type=int, default=0, help="of the random draws (default 0)")
    parser.set_defaults(run=run)


class _Number:
    """A number in a range."""

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high

    def __call__(self, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not self.low <= value <= self.high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number from {self.low:g} to {self.high:g}")
        return value


def run(args: argparse.Namespace) -> int:
    """Design, write, tell."""
    import shlex

    from daq import InputError, load_rig
    from daq.recording import write_plan
    from experiments.rig import rig_path

    args.rig = str(rig_path(args.rig))
    rig = load_rig(args.rig)
    if args.seed < 0:
        raise InputError("--seed", f"{args.seed} is negative", "give a number from 0 on")
    if args.next is not None and args.session is None:
        raise InputError("--next", "answers with a session of plans", "give --session DIR instead of --out")
    if args.session is not None and not args.model:
        raise InputError("--session", "is designed by a model of the rig", "give --model MODEL.json")
    if args.peak is not None and args.model:
        raise InputError("--peak", "is for a plan without a model", "leave out --peak; --margin scales the plan")
    if args.separate is not None and (args.session is not None or not args.model):
        raise InputError("--separate", "designs one plan by a model of the rig", "give --model and --out")
    if args.session is not None:
        return _session(args, rig)
    if args.holds is not None and (args.model or args.session):
        raise InputError("--holds", "is a plan without a model", "leave out --model and --session")
    plan = _separating(args, rig) if args.separate else _designed(args, rig) if args.model else _plain(args, rig)
    write_plan(plan, args.out)
    print(f"{args.out}: {plan.duration_s:.1f} s, at most {plan.peak_nm:.3g} N m. "
          f"Next: legid record --rig {shlex.quote(args.rig)} --plan {shlex.quote(args.out)} --out RUN.mcap")
    return 0


def _prior(args: argparse.Namespace, rig: Rig) -> tuple[Bench, Band, Search]:
    """What a design is made on, in which band, and how it is sought."""
    from experiments.excite import USUAL_HIGH_HZ, Band, Bench, Search
    from experiments.models import load_model

    return (Bench(load_model(args.model), rig, args.model, args.doubt),
            Band(args.seconds, args.low or 0.0, USUAL_HIGH_HZ if args.high is None else args.high),
            Search(args.margin, args.criterion, int(args.tries), int(args.steps), args.seed))


def _session(args: argparse.Namespace, rig: Rig) -> int:
    """A folder of plans, told of."""
    from pathlib import Path

    from experiments.console import stages
    from experiments.excite import next_choice, plan_session, session_text, usual_choice, write_session

    choice = usual_choice() if args.next is None else next_choice(args.next)
    bench, band, search = _prior(args, rig)
    with stages("designing") as show:
        session = plan_session(bench, band, search, choice, int(args.runs), show)
    write_session(session, Path(args.session), args.rig, args.model, args.margin)
    print(session_text(session, Path(args.session)))
    return 0


def _designed(args: argparse.Namespace, rig: Rig) -> Plan:
    """The best plan by the prior model, told of on the way."""
    from experiments.console import stages
    from experiments.excite import design, design_text

    bench, band, search = _prior(args, rig)
    with stages("designing") as show:
        found = design(bench, band, search, lambda done, total: show(f"{done:.1f} of {total:g} starts", done / total))
    print(design_text(found, rig.limits))
    return found.best.plan


def _separating(args: argparse.Namespace, rig: Rig) -> Plan:
    """The plan that tells rivals apart, told of on the way."""
    from experiments.console import stages
    from experiments.excite import contest_of, question_of, separate, separation_text, widening_bands
    from experiments.models import load_model
    from experiments.session import setup_of

    question = question_of(args.separate)
    bench, band, search = _prior(args, rig)
    model = load_model(args.model)
    contest = contest_of(bench, question, model, setup_of([], rig, model.provenance.sensors).options)
    bands = [band] if args.high is not None else widening_bands(band.seconds, band.low_hz, rig.sampling.planned_hz)
    with stages("designing") as show:
        found = separate(contest, bands, search,
                         lambda done, total: show(f"{done:.0f} of {total:.0f} plans", done / total))
    print(separation_text(found, question))
    return found.best.plan


def _plain(args: argparse.Namespace, rig: Rig) -> Plan:
    """Equal sines with random phases, or a staircase; nothing is known of what they will do."""
    from experiments.excite import USUAL_HIGH_HZ, first_plan

    holds = None if args.holds is None else int(args.holds)
    high_hz = USUAL_HIGH_HZ if args.high is None else args.high
    return first_plan(rig, args.seed, args.seconds, args.peak, args.low, high_hz, holds)
