"""`make servo-laws`: friction laws of servos fitted to the same runs, free runs of runs that no fit has seen.

The laws are those of BAM (Duclusaud, Passault, Padois, Ly, ICRA 2025; bam/model.py of Rhoban/bam), from Coulomb and
viscous friction to friction by load. All are fitted alike, by the error of free runs under the command.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from estimator.loops import law_checks
from evidence import servo_bam
from evidence.frame import Lines, program, table
from evidence.registry import Evidence
from evidence.servo_fits import LAWS, Run, fitted, published, rms, run_of
from experiments.models import build_mechanism, mechanism_settings


def xl330(kinds: tuple[str, ...]) -> list[Run]:
    """Runs of the XL330 with the gains that its duty shows."""
    datasets, mechanism = servo_bam.records(kinds), build_mechanism(mechanism_settings(servo_bam.rig()))
    (check,) = law_checks(servo_bam.records(servo_bam.TEST), mechanism)
    gains = dict(zip(("kp100", "kp400"), map(float, check.after.gains)))
    return [run_of(d.time_s, d["q1_cmd_rad"], d["volts"], d["torque_enable"], d["q1_rad"], gains[d.name[:5]])
            for d in datasets]


def page() -> Lines:
    train, test = xl330(servo_bam.TRAIN), xl330(servo_bam.TEST)
    yield from [
        "# Servos: friction laws fitted to the same runs",
        "Runs of 6 s of an XL330 with a pendulum follow BAM's commands. All laws are fitted to the same runs by the "
        "error of free runs, so the laws alone differ. No fit has seen `sin_time_square`. Published values were found "
        "on other records, which may have these among them."]
    laws = {f"fitted: {name}": fitted(train, count) for name, count in LAWS.items()}
    laws |= {f"published {name}": min((published(values, sign) for sign in (1.0, -1.0)),
                                      key=lambda p: sum(rms(p, test)))
             for name, values in servo_bam.PUBLISHED.items()}
    yield table("law | held out, kp 100 | held out, kp 400 | fitted runs", [
        *((name, *mrad(rms(p, test)), *mrad([np.sqrt(np.mean(np.square(rms(p, train))))]))
          for name, p in laws.items()),
        *((name, *mrad(errors), "-") for name, errors in servo_bam.errors().items())])
    verdict, causes, error = servo_bam.diagnosis()
    before, after = error or (np.nan, np.nan)
    yield (f"`legid diagnose` of the six fitted runs: `{verdict}`, {', '.join(causes) or 'nothing'}. The "
           f"error is {before:.3g} times noise before and {after:.3g} after. The samples of "
           "`lift_and_drop` with the motor off have no input: an open motor has no back-EMF.")


def mrad(errors: Iterable[float]) -> Iterator[str]:
    return (f"{1e3 * one:.3g} mrad" for one in errors)


EVIDENCE = Evidence(
    "Friction laws of servos, fitted to the same runs: what do they leave on runs that none has seen?",
    "make servo-laws", "servo-laws.md", 4,
    "at most that of BAM's best law, fitted to the same runs",
    (r"(fitted: and by load \(m6\) \| [^|]*\| [^|]*)\|", r"(legid, mle: and directional[^|]*\| [^|]*\| [^|]*)\|"))
main = program(page)
