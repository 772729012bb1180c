"""Where new users hesitated with files of other people (docs/evidence/real-files.md, Three journeys)."""

from pathlib import Path

import numpy as np

from experiments.judge import number
from tests.support.imported_files import guess, table
from tests.support.motions import pendulum
from tests.support.shell import Shell, typed


def swinging(rate_hz: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] and the angle (n,) [rad] of a pendulum that whirls slower and slower, then swings."""
    t = np.arange(0.0, 20.0, 1.0 / rate_hz)
    return t, pendulum(t, lambda _: 0.0, 0.1, 9.0, (0.15, 0.0), 10.0)


def test_a_wrap_shows_the_unit_and_a_name_keeps_its_backslash(tmp_path: Path,
                                                              shell: Shell) -> None:
    t, q = swinging()
    degrees = (np.degrees(q) + 180.0) % 360.0 - 180.0
    column = guess(table(tmp_path / "a.csv", {"t": t, r"$\theta$": degrees, "u": np.sin(t)}))["q1_rad"]
    assert (column.name, column.unit) == (r"$\theta$", "deg") and r'"$\\theta$"' in (tmp_path / "a.toml").read_text()
    assert "'u' may drive a joint" in shell.err


def test_steps_of_time_are_no_times(here: Path, shell: Shell) -> None:
    t, q = swinging(25.0)
    elapsed = 40.0 + np.random.default_rng(1).integers(-1, 2, t.size)
    table(here / "a.csv", {"position": q, "elapsed": elapsed})
    said = shell.fails("import a.csv --guess --map c.toml")
    assert "'elapsed' is the step from row to row, 40 in the median; give the rate by --rate HZ" in said


def test_two_links_of_which_the_first_has_a_motor_are_a_chain(here: Path) -> None:
    t, q = swinging()
    table(here / "a.csv", {"time_s": t, "q1_rad": q, "q2_rad": 0.1 * q, "tau1_nm": np.sin(t)})
    typed("init rig.toml --from a.csv")
    assert 'model = "chain"' in (here / "rig.toml").read_text()


def test_a_number_of_no_size_is_short() -> None:
    assert number(-5.0e95, 8e90) == "-5e+95"
