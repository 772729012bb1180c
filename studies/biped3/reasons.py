"""Why a study's numbers differ from the paper's; figures in the sentences are the study's own where it has them.

The others are held by tests/studies/test_study.py.
"""

from __future__ import annotations

import numpy as np

from studies.biped3.claims import in_words
from studies.biped3.study import PAPERS_MLE
from studies.biped3.table import LABELS, Cell, Table


def reasons(table: Table) -> list[str]:
    """One or two sentences each."""
    found = [
        "The paper prints neither controller nor initial state nor hold between samples. Here they are the walker of "
        "Grizzle, Abba and Plestan (2001) just after an impact of its periodic gait, with a zero-order hold of 10 ms. "
        "Errors therefore differ in size from the paper even where a method is the same.",
        _differences(table),
        "The paper's MLE (1.15 to 1.24) carries the bias of differences too. The MLE here does not: its motion is one "
        "function whose derivatives are exact, under torque that acts as the hold says.",
        _papers_mle(table),
        "Least squares compares a symmetric difference with the mean of the torques held before and after the sample; "
        "with the held torque of the sample itself its error in case 1 would be 45 rad² without any noise.",
        _singular(table),
        "WLS weighs each joint's torque by its own residual. `--methods wls-known` uses the known covariance in (29) "
        "and the small passive entry that RLS needs. Its mean error in case 3 is then 33 rad² in place of "
        "115 with 0.03 N m, and 75 with 0.316.",
        "RLS needs a small number in place of the passive joint's variance, which the paper does not give. Here it is "
        "the square of 0.03 N m. Other levels from 0.001 to 10 N m raise or lower its errors, and leave them far above "
        "those of MLE in cases 1 to 4.",
        "HEKF knows the hold here, and is better than in the paper where the absolute angle is nearly exact; with more "
        "noise its linearisation fails, as the paper reports.",
        "A simulation counts as failed where the inertia matrix becomes singular on the way or a rate passes 10⁴ "
        "rad/s, or where there is no fit. The paper does not say what it counted.",
        _curved(table),
    ]
    if any(case.number == 5 for case in table.cases):
        found.append("Case 5 has no row in Table III and no filter in Table II; it is filtered like case 4 here.")
    return [reason for reason in found if reason]


def _differences(table: Table) -> str:
    shown = ", ".join(f"{table.differences[case.number]:.{2 if table.differences[case.number] < 10 else 0}f}"
                      for case in table.cases)
    return (f"WLS-FCD without any noise leaves {shown} rad² in "
            f"{in_words([case.number for case in table.cases])}: the bias of Table II's filters and differences. "
            "Torque and acceleration change fast just after the impact, and wider differences smear that. A step that "
            "starts without the impact would leave less than 0.1 rad² in every case, below what the paper prints.")


def _papers_mle(table: Table) -> str:
    cells = [cell for cell in table.cells if cell.method == PAPERS_MLE]
    if not cells:
        return ("The paper's own MLE, with free latents and central differences, joins the table with "
                f"--methods mle,{PAPERS_MLE},wls,rls,hekf.")
    return ("'MLE of the paper' is its algorithm as printed, with free latents and central differences (exact "
            "derivatives in place of numerical ones). In the last case the paper, too, calls it unreliable. It hinges "
            "on the number in place of the passive joint's variance as RLS does: in case 3 its median error falls from "
            "1.05 to 0.54 rad² when that is the square of 0.316 instead of 0.03 N m.")


def _singular(table: Table) -> str:
    cells = [c for c in table.cells if c.method in ("wls", "rls") and c.median_over_truth[1] < 0.0]
    if not cells:
        return ""
    where = ", ".join(f"{LABELS[c.method]} case {c.case} {c.median_over_truth[1]:.2f}"
                      for c in sorted(cells, key=lambda c: (c.method != "wls", c.case)))
    return ("Where least squares fails, it has lost the swing leg's inertia beta2: its median estimate over the truth "
            f"is below zero ({where}), and the inertia matrix of such a model is or becomes singular.")


def _curved(table: Table) -> str:
    cells: list[Cell] = [c for c in table.cells if c.method == "mle" and c.mse_over_bound_all_directions > 1.3]
    if not cells:
        return ""
    return ("Averaged over all directions instead of parameters, MLE's mean squared error is "
            + ", ".join(f"{c.mse_over_bound_all_directions:.3g} times the bound in case {c.case}" for c in cells)
            + ". One combination of parameters is there known some 30 times better than each of them, and to second "
            "order the large errors of the others leak into it. The likelihood ratio, which does not "
            f"depend on such curvature, stays near 8 ({', '.join(f'{c.likelihood_ratio:.1f}' for c in cells)})."
            if np.isfinite([c.likelihood_ratio for c in cells]).all() else "")
