"""What one effect in addition to an answer says of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from estimator.diagnosis import further_effect, search
from estimator.diagnosis.context import Explanation, keys_of
from estimator.errors import FitError
from tests.support.stated_fits import Context, explained


@pytest.fixture(autouse=True)
def no_likelihood(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deviances, starts and scores are stated."""
    monkeypatch.setattr(search, "best_shapes", lambda context, *_: range(len(context.candidates)))
    monkeypatch.setattr(search, "start_size", lambda *_: np.zeros(1))
    monkeypatch.setattr(further_effect, "deviance", lambda model: model.deviance)
    monkeypatch.setattr(further_effect, "assess", lambda _, explanations: list(explanations))
    monkeypatch.setattr(further_effect, "admissible", lambda _: True)


def with_one_more(monkeypatch: pytest.MonkeyPatch, gains: dict[str, float], held_out: float = 1.0, **further: float
                  ) -> tuple[Any, Explanation, list[Explanation]]:
    """A spring and what is found in addition to it; `held_out`: of one held-out run, the share of that gain."""
    spring = explained(9000.0, "spring")
    context = Context({name: 100.0 for name in gains})
    monkeypatch.setattr(context, "material", lambda _: 120.0, raising=False)
    context.split.discover = (0,)

    def fits(_: object, starts: Any) -> list[Explanation]:
        return [replace(explained(9000.0 + gains[key], "spring", key), further=np.array([further.get(key, 0.0)]))
                for _, start in starts for key in (start[-1][0].key,)]

    monkeypatch.setattr(search, "pairs_of", lambda model: [(e, np.zeros(1)) for e in model.effects])
    monkeypatch.setattr(further_effect, "fit_sets", fits)
    monkeypatch.setattr(further_effect, "run_deviance",
                        lambda model, run: model.deviance * (held_out if run == 6 else 1.0))
    return context, spring, further_effect.with_one_more(cast(Any, context), spring)


def present_too(*given: Any, **more: Any) -> set[str]:
    found = further_effect.present_too(*with_one_more(*given, **more))
    return set() if found is None else set(keys_of(found) - {"spring"})


def test_an_effect_that_every_held_out_run_shows_is_present_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A torque 6 ms late with a spring: the free-run error falls from 1.003 floors by nothing."""
    assert present_too(monkeypatch, {"delay": 4230.0, "ripple": 400.0}) == {"delay"}
    assert present_too(monkeypatch, {"delay": 4230.0}, held_out=-1.0) == set()  # one run is less likely with it
    assert present_too(monkeypatch, {"delay": 100.0}) == set()  # too little to look at
    assert present_too(monkeypatch, {"tilt": 4230.0, "bias": 4228.0}) == set()  # not told apart
    assert present_too(monkeypatch, {"tilt": 4230.0, "bias": 4100.0}, tilt=300.0, bias=500.0) == set()
    assert present_too(monkeypatch, {"play": 4230.0}, play=4231.0) == set()  # as an arm's: another term explains more
    given = with_one_more(monkeypatch, {"delay": 4230.0})
    monkeypatch.setattr(further_effect, "run_deviance", lambda *_: (_ for _ in ()).throw(FitError("no smoother")))
    assert further_effect.present_too(*given) is None
    plain = replace(explained(9.0, "spring"), has_residual=False)
    assert further_effect.with_one_more(cast(Any, Context({"delay": 4230.0})), plain) == []


def test_what_one_further_effect_explains_more_than_is_an_imitation(monkeypatch: pytest.MonkeyPatch) -> None:
    """An encoder's offset that the library lacked: an eccentricity gained 20,820, a spring with it 26,249 more."""
    for gain, imitated in ((8999.0, False), (9001.0, True)):
        context, spring, more = with_one_more(monkeypatch, {"stiffness": gain})
        assert further_effect.imitates(context, spring, more) is imitated
    context, spring, _ = with_one_more(monkeypatch, {"delay": 1.0})
    dead_band = replace(spring, further=np.array([9001.0]))  # a generic term, by its score
    assert further_effect.imitates(context, dead_band, []) and not further_effect.imitates(context, spring, [])
    context, spring, more = with_one_more(monkeypatch, {"scale": 9001.0})
    second = [replace(e, has_residual=False) for e in more]  # a cause
    assert not further_effect.imitates(context, spring, second)
    context.deviance = -9100.0  # the nominal model is likelier
    assert further_effect.imitates(context, spring, [])
