"""Results that show themselves, without pandas too, and an import that costs nothing."""

import subprocess
import sys
import time
from dataclasses import replace
from html import escape, unescape
from pathlib import Path

import numpy as np
import pytest
from msgspec import Struct
from numpy.testing import assert_array_equal

import legid
from daq import parse_rig
from estimator import Combination
from experiments.models import mechanism_settings
from legid.tables import columns
from tests.support.fits import synthetic_fit

TOML = '[mechanism]\nmodel = "leg2"\nactuated = [2]\n'
RIG = parse_rig(TOML)


def two_columns(name: str = "run1.csv") -> legid.Dataset:
    t = np.arange(60) / 100.0
    return legid.Dataset(name, 100.0, t, {"q2_rad": np.where(t < 0.095, np.nan, t), "tau2_nm": 0.0 * t}, rig=RIG)


def test_import_is_quick() -> None:
    """The best of three, so that a busy machine does not decide; nothing of numerics is loaded."""
    code = "import legid, sys; assert 'numpy' not in sys.modules and 'daq' not in sys.modules"
    spent = []
    for _ in range(3):
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        spent.append(time.perf_counter() - begin)
    assert min(spent) < 0.3


def test_every_name_that_is_offered_is_there() -> None:
    names = vars(legid)["__all__"]
    assert {"fit", "load", "diagnose", "Dataset", "Rig", "InputError"} <= set(names)
    assert all(getattr(legid, name) is not None for name in names)


def test_a_fit_as_table_and_page() -> None:
    plain, settings = synthetic_fit(), mechanism_settings(RIG)
    found = legid.FitResult.of(plain, settings)
    table = found.to_frame()
    assert_array_equal(table["value"], plain.beta)
    assert_array_equal(found.beta, plain.beta)
    assert_array_equal(table[["low", "high"]], plain.ci95())
    assert table.loc["beta1", "unit"] == "kg m^2"
    unsure = legid.FitResult.of(replace(plain, converged=False, undetermined=(
        Combination((("beta8", 1.0), ("beta9", -1.0))),)), settings)
    assert list(unsure.to_frame()["value"].isna()) == [False] * 7 + [True, True]
    page = unescape(unsure._repr_html_())
    assert "the fit did not converge" in page and page.count("not determined") == 2 and "m2*l1*lc2" in page


def test_a_run_as_table_page_and_figure() -> None:
    run = two_columns("a <b>.csv")
    assert run.to_frame().shape == (60, 2) and run.to_frame()["q2_rad"].isna().sum() == 10
    assert run._repr_html_() == f"<pre>{escape(str(run))}</pre>" and "a &lt;b&gt;.csv" in run._repr_html_()
    figure = run.plot()
    assert [ax.get_ylabel() for ax in figure.axes] == ["q2 [rad]", "tau2 [N m]"]
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    part = run.part(slice(20, 40))
    assert isinstance(part, legid.Dataset) and part.rig == RIG and len(part) == 20


def test_without_pandas_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(legid.WorkError, match=r'pip install "legid\[notebook\]"'):
        two_columns().to_frame()


def test_runs_without_a_rig_or_of_two_rigs_are_refused() -> None:
    bare = legid.Dataset("bare", 100.0, np.arange(5.0), {})
    other = replace(two_columns("run2.csv"), rig=parse_rig(TOML.replace("2]", "1, 2]")))
    for runs, told in (([bare], "bare: was not loaded with a rig"), ([], "is empty"),
                       ([two_columns(), other], r"run2\.csv: was loaded with another rig than run1\.csv")):
        with pytest.raises(legid.InputError, match=told):
            legid.fit(runs)
    with pytest.raises(legid.InputError, match="holds no rig"):
        legid.load("run.csv")


def test_columns_of_structs_lead_below_and_rename_and_open_intervals() -> None:
    class Below(Struct):
        ci95: tuple[float, float] | None
        unit: str = "N m"

    class Row(Struct):
        name: str
        part: Below | None

    rows = [(1, Row("a", Below((1.0, 2.0)))), (2, Row("b", None)), (3, Row("c", Below(None)))]
    assert columns(rows, "run=0 1.name 1.part.ci95 of=1.part.unit") == {
        "run": [1, 2, 3], "name": ["a", "b", "c"], "low": [1.0, None, None], "high": [2.0, None, None],
        "of": ["N m", None, "N m"]}
    assert columns([], "1.ci95 unit") == {"low": [], "high": [], "unit": []}


def test_rows_of_a_result_print_as_a_table(tmp_path: Path) -> None:
    """`print(result.parameters)` was a tuple of structs on one line."""
    found = legid.FitResult.of(synthetic_fit(), mechanism_settings(RIG))
    found.to_json(tmp_path / "fit.json")
    for one in (found, legid.FitResult.read(tmp_path / "fit.json")):
        head, rule, first, *others = str(one.parameters).splitlines()
        assert head.split()[:3] == ["name", "meaning", "unit"] and set(rule) == {"-", " "} and len(others) == 8
        assert first.startswith("beta1") and f"{found.beta[0]:.4g}" in first and "(" not in first
        assert isinstance(one.parameters, tuple) and one.parameters[0].name == "beta1"
