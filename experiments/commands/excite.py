"""`legid excite`: design a torque plan."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from daq.plan import Plan
    from daq.rig import Rig

FIRST_SHARE = 0.1
"""Peak of a first plan, as a share of the torque limit."""



def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "excite", help="design an excitation within the rig's limits",
        description="Search the odd random-phase multisine that tells most about all parameters together (D-optimal), "
                    "by a prior model of the rig; the simulated motion stays within the rig's limits, with a margin. "
                    "Give another --seed for each further realisation. Without a model, a plain multisine of --peak: "
                    "what the motion will be is then unknown, so begin gently.")
    parser.add_argument("--rig", required=True, help="the rig's TOML file; its [limits] are kept")
    parser.add_argument("--model", metavar="MODEL.json", help="prior model, from an earlier fit")
    parser.add_argument("--peak", metavar="NM", type=_Number(1e-6, 1e6),
                        help="without --model: largest torque; default: a tenth of the rig's limit")
    parser.add_argument("--out", metavar="PLAN", required=True, help="torque plan to write (CSV)")
    parser.add_argument("--seconds", type=_Number(2.0, 600.0), default=20.0, help="length (default 20)")
    parser.add_argument("--low", metavar="HZ", type=_Number(0.0, 25.0), default=0.1,
                        help="lowest frequency (default 0.1)")
    parser.add_argument("--high", metavar="HZ", type=_Number(0.0, 25.0), default=3.0,
                        help="highest frequency (default 3)")
    parser.add_argument("--margin", type=_Number(0.05, 1.0), default=0.8, help="share of each limit used (default 0.8)")
    parser.add_argument("--tries", type=_Number(1, 100_000), default=60, help="plans to simulate (default 60)")
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
    from daq.errors import InputError
    from daq.plan import write_plan
    from daq.rig import load_rig

    rig = load_rig(args.rig)
    if args.seed < 0:
        raise InputError("--seed", f"{args.seed} is negative", "give a number from 0 on")
    if args.peak is not None and args.model:
        raise InputError("--peak", "is for a plan without a model", "leave out --peak; --margin scales the plan")
    plan = _designed(args, rig) if args.model else _plain(args, rig)
    write_plan(plan, args.out)
    print(f"{args.out}: {plan.duration_s:.1f} s at most {plan.peak_nm:.3g} N m")
    return 0


def _designed(args: argparse.Namespace, rig: Rig) -> Plan:
    """The best plan by the prior model, told of on the way."""
    from daq.errors import InputError
    from experiments.excite_design import Band, design, design_text
    from experiments.model_file import load_model
    from experiments.output import busy

    model = load_model(args.model)
    if model.mechanism.model != rig.mechanism.model or model.mechanism.actuated != rig.mechanism.actuated:
        raise InputError(args.model, f"is of a {model.mechanism.model}, the rig is a {rig.mechanism.model} or drives "
                                     "other joints", "give a model of this rig")
    with busy("designing"):
        found = design(model, rig.limits, Band(args.seconds, args.low, args.high), args.margin, int(args.tries),
                       args.seed, args.model)
    print(design_text(found, rig.limits))
    return found.plan


def _plain(args: argparse.Namespace, rig: Rig) -> Plan:
    """Equal sines with random phases, nothing known of what they will do."""
    from daq.errors import InputError
    from experiments.excitation import random_multisine

    limit = rig.limits.torque_nm
    peak = FIRST_SHARE * limit if args.peak is None else args.peak
    if peak > limit:
        raise InputError("--peak", f"{peak:g} N m is beyond the rig's limit of {limit:g} N m", "lower it")
    try:
        return random_multisine(args.seed, args.seconds, peak, low_hz=args.low, high_hz=args.high)
    except ValueError as error:
        raise InputError("--seconds", str(error), "give more seconds or a wider band") from None
