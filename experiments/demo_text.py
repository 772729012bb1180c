"""What the demo says at its end."""

from __future__ import annotations

from experiments.demo import RUNS, Demo
from experiments.fit_text import number
from experiments.output import text_table


def demo_text(demo: Demo) -> str:
    """What was found, against the truth, and where everything is."""
    result = demo.result
    rows = [[p.name, number(demo.truth[p.name], float(std)), number(float(value), float(std)),
             f"{number(float(low), float(std))} .. {number(float(high), float(std))}",
             "" if low <= demo.truth[p.name] <= high else "outside", p.unit, p.meaning]
            for p, value, std, (low, high) in zip(result.mechanism.parameters, result.beta, result.std,
                                                  result.ci95())]
    fitted = ", ".join(data.name for data in demo.setup.datasets[:-1])
    free_run = demo.validations[0]
    lines = [f"Recorded {RUNS} runs on an emulated leg, identified it from {fitted} (IMU, knee encoder, torque), "
             f"validated on {free_run.run}.", "",
             text_table(["parameter", "truth", "found", "95 % interval", "", "unit", "meaning"], rows, {1, 2, 3}), "",
             f"{demo.inside()} of {len(rows)} parameters of the plant lie inside their 95 % intervals.",
             "Free-run simulation over "
             f"{free_run.horizon_s:.0f} s of data not used for the fit: rms error "
             f"{free_run.rmse['q1_rad']:.3f} rad at the pivot, {free_run.rmse['q2_rad']:.3f} rad at the knee.", ""]
    lines += [f"{what + ':':13} {path}" for what, path in demo.files.items()]
    return "\n".join([*lines, "", f"Open {demo.files['report']} in a browser. ({demo.wall_s:.0f} s)"])
