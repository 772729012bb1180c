"""Features of the motion inside sampling intervals, against a cubic's own."""

import numpy as np

from estimator.model import GAUSS, Collocation, leg2

DT = 0.02


def test_a_cubic_has_its_own_features() -> None:
    """More intervals than are gathered at a time, as a slice and one by one, with a gap."""
    cubic = [np.polynomial.Polynomial(c) for c in np.random.default_rng(0).normal(size=(2, 4))]
    time = DT * np.arange(151)
    q, v = (np.column_stack([p.deriv(k)(time) for p in cubic]) for k in (0, 1))
    collocation = Collocation(leg2(), DT, "linear")
    motion = collocation.motion(q, v, slice(0, 150))
    for g, share in enumerate(GAUSS):
        inside = time[:-1] + share * DT
        half = time[:-1] + 0.5 * g * DT
        for j, p in enumerate(cubic):
            for found, known in ((motion.angle, p(inside)), (motion.rate, p.deriv()(inside)),
                                 (motion.accel, p.deriv(2)(inside)), (motion.rate_from, p.deriv()(half)),
                                 (motion.rate_to, p.deriv()(half + 0.5 * DT))):
                np.testing.assert_allclose(found[j, g], known, rtol=0.0, atol=1e-9 * np.abs(known).max())
    which = np.delete(np.arange(150), 70)
    for part, whole in zip(collocation.motion(q, v, which), motion):
        np.testing.assert_array_equal(part, whole[..., which])
