"""`eliminate`: the latents out of the normal equations, by the compiled sweep or in odd-even order by arrays."""

from __future__ import annotations

from estimator import compiled, oddeven, sweep
from estimator.chain import Chain


def eliminate(chain: Chain) -> sweep.Swept | oddeven.Eliminated:
    """Factor `chain` and go forward through its right sides; it is used up.

    Raises numpy.linalg.LinAlgError where its matrix is not positive definite.
    """
    return (sweep if compiled.ready() else oddeven).eliminate(chain)
