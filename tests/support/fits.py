"""A fit made of sines, for pages and files, and its document."""

from dataclasses import replace

import numpy as np

from estimator import FitResult, Trajectory
from estimator.model import leg2
from experiments.documents import FitDocument
from experiments.emulation import LegBody
from experiments.models import MechanismSettings
from experiments.reports import Section, fit_sections, fit_text
from experiments.reports.html import render_page


def synthetic_fit() -> FitResult:
    """A fit as an estimator would return it, its motion made of sines."""
    mechanism = leg2(lever_arm=0.2)
    rng = np.random.default_rng(3)
    t = np.arange(1500) / 100.0
    q = np.stack([0.3 * np.sin(2 * t), 0.8 * np.sin(3 * t + 1)], axis=1)
    qd, qdd = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    beta = np.array(LegBody().beta())
    tau = mechanism.inverse_dynamics(q, qd, qdd, beta)
    tau[:, 0] = 0.02 * rng.standard_normal(t.size)
    predicted = {"gyro_radps": qd[:, 0], "accel_x_mps2": 0.2 * qdd[:, 0] + 9.81 * np.sin(q[:, 0]),
                 "accel_y_mps2": -0.2 * qd[:, 0] ** 2 - 9.81 * np.cos(q[:, 0])}
    measured = {k: v + 0.05 * rng.standard_normal(t.size) for k, v in predicted.items()}
    shown = np.stack([np.zeros(t.size), tau[:, 1] + 0.02 * rng.standard_normal(t.size)], axis=1)
    path = Trajectory("run1.mcap", t, q, qd, qdd, tau, shown, measured, predicted)
    covariance = np.diag((0.01 * beta + 1e-4) ** 2)
    return FitResult(mechanism, "mle", "imu", beta, covariance, {"gyro_radps": 0.005, "accel_mps2": 0.05},
                     np.array([0.02, 0.021]), True, 7, 1500, 0.4, (), ("noise is white",), (), (path,))


def with_slow_gyro(path: Trajectory) -> Trajectory:
    """The same motion with a gyro whose error wanders."""
    slow = 0.15 * np.sin(0.8 * path.time_s)
    return replace(path, measured={**path.measured, "gyro_radps": path.measured["gyro_radps"] + slow})


def document_of(result: FitResult, model: str = "leg2") -> FitDocument:
    """`legid.fit/1` of a fit without runs."""
    return FitDocument.of(result, MechanismSettings(model=model, actuated=(2,), lever_arm_m=0.2))


def text_of(result: FitResult) -> str:
    """What the terminal shows."""
    return fit_text(document_of(result))


def sections_of(result: FitResult) -> list[Section]:
    """Those of its page."""
    return fit_sections(document_of(result), result)


def page_of(result: FitResult) -> str:
    """These as a page."""
    return render_page("Fit", "", sections_of(result))
