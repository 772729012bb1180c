"""What is refused before it would take all memory."""

import numpy as np
import pytest

from daq import Dataset
from estimator import FitError, FitOptions
from estimator.fitting import fit_admissible
from estimator.likelihood import memory
from estimator.model import joint1


def test_a_record_that_no_memory_holds_is_refused_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(2000) / 100.0
    run = Dataset("long", 100.0, time, {"q1_rad": np.sin(time), "tau1_nm": np.cos(time)})
    monkeypatch.setattr(memory, "physical_memory", lambda: 1e6)
    with pytest.raises(FitError, match=r"2000 samples needs about \S+ GB .* machine has 0.001 GB: lower rate_hz"):
        fit_admissible([run], joint1(), FitOptions(sensors="encoder", encoders=(0,)))


def test_this_machine_has_memory_for_an_hour_at_the_usual_rate() -> None:
    memory.refuse_too_long(360_000, 6, 10)
    assert memory.physical_memory() > 1e8
