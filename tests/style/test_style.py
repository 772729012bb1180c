"""The checks of `make lint` see what they are for."""

import re
from pathlib import Path

import pytest

from tests.style import layout, pages, tokens, words
from tests.style.vocabulary import IN_PAGES, WORDS, compiled, lix
from tests.support.paths import ROOT


def test_docstrings_comments_and_blank_space_are_no_code() -> None:
    source = '"""What it is."""\n\n# why\ndef f(x: int) -> str:\n    """What comes back."""\n\n    return "a b"\n'
    assert tokens.tokens(source) == tokens.tokens('def f(x: int) -> str: return "a b"') == 12


def test_a_package_that_grows_is_refused_and_one_that_shrinks_lowers_its_limit(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = tokens.allowed()
    assert set(limits) == {"drivers", "daq", "estimator", "experiments", "legid"}
    assert not list(tokens.beyond(limits, limits))
    (refused,) = tokens.beyond({**limits, "daq": limits["daq"] + 3}, limits)
    assert refused.startswith("daq: ") and " 3 more than pyproject.toml allows" in refused
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers/a.py").write_text("a = 1\n")
    settings = tmp_path / "pyproject.toml"
    settings.write_text("[tool.legid.tokens]\ndrivers = 9\n")
    monkeypatch.setattr(tokens, "ROOT", tmp_path)
    monkeypatch.setattr(tokens, "SETTINGS", settings)
    tokens.lower()
    assert tokens.allowed() == {"drivers": 3}
    (tmp_path / "drivers/a.py").write_text("a = b = 1\n")
    assert len(list(tokens.problems())) == 1
    tokens.lower()
    assert tokens.allowed() == {"drivers": 3}


def test_every_floor_is_read() -> None:
    assert {p.relative_to(ROOT).parts[0] for p in layout.FILES} == set(layout.FLOORS)


def test_a_circle_a_look_past_a_face_and_a_climb_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert layout.storeys({"a": {"b"}, "b": {"a"}}) == "a -> b -> a"
    assert layout.storeys({"a": {"b"}, "b": set()}) == {"a": 2, "b": 1}
    monkeypatch.setattr(layout, "imports", lambda module: {("estimator.fitting.mle", "fit_mle")})
    assert list(layout.past_faces("legid.api")) == [
        "estimator.fitting.mle is inside estimator.fitting: take fit_mle from estimator.fitting"]
    assert not list(layout.past_faces("estimator.fitting.fit"))
    assert list(layout.climbs("drivers.drive")) == ["imports estimator.fitting.mle.fit_mle"]
    assert not list(layout.climbs("legid.api"))


def test_a_room_that_needs_one_above_it_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not list(layout.rooms_out_of_order("legid"))
    monkeypatch.setattr(layout, "needs", lambda module: {"legid.api"} - {module})
    assert "legid.tables -> legid.api" in list(layout.rooms_out_of_order("legid"))
    monkeypatch.setitem(layout.ROOMS, "legid", [["api"]])
    assert next(layout.rooms_out_of_order("legid")).startswith("ROOMS and the folder differ: ")


def test_a_test_that_borrows_from_another_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "test_a.py"
    path.write_text("from tests.daq.test_b import c\n")
    assert list(layout.borrowed(path)) == ["takes tests.daq.test_b.c from another test; put it into tests/support"]


def test_words_and_sentences_are_seen(tmp_path: Path) -> None:
    path = tmp_path / "kept_back.py"
    many = "word " * 31
    path.write_text(f'"""Of no end"""\nLOUD = f"what is {{1}} left over {{2}}"  # it strays\n'
                    f'def settle(doubts: int) -> str:\n    """Returns {many}."""\n    return "{many}"\n')
    found = [re.split(r" \(say|: ", line.split(": ", 1)[1])[0]
             for one in words.said_in(path) for line in words.complaints("estimator/x.py", one)]
    assert found == ["docstring has no first sentence", "docstring does not begin with what comes back",
                     "name 'kept_back'", "comment 'strays'", "message 'left over'",
                     "name 'LOUD'", "name 'doubts'", "name 'settle'", "docstring has a first sentence of 32 words",
                     "message has a sentence of 31 words"]


def test_a_hard_page_and_a_long_sentence_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hard = ("Candidates imitated by nominal parameters except for insignificant information contributions, "
            "notwithstanding considerable individual likelihood improvements, necessitate comparison.")
    assert lix([hard]) > 60.0 and lix(["The fit does not converge.", "Give more runs of it."]) < 30.0
    page = f"A mended page. A {'word ' * 31}end.\n\n| table {'word ' * 40}|\n\n```sh\n{'code ' * 40}\n```\n"
    assert [len(s.split()) for s in pages.sentences(page) if s] == [3, 33]
    assert any(word.search(page) for word, _ in compiled(WORDS | IN_PAGES))
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    (tmp_path / "README.md").write_text(page)
    assert list(pages.wrong_words(tmp_path / "README.md")) == ["'mended' -> fix"]
    assert [said.split(":")[0] for said in pages.too_much(tmp_path / "README.md")] == ["a sentence of 33 words"]


def test_a_changelog_without_order_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not list(pages.changelog())
    (tmp_path / "pyproject.toml").write_text('fallback_version = "0.2.0"')
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    releases = "# Changelog\n\n## [Unreleased]\n\nshort\n\n## [0.1.0] - 2026-01-01\n\n## [0.2.0] - 2026-02-01\n"
    (tmp_path / "CHANGELOG.md").write_text(releases)
    assert [said.split(":")[0] for said in pages.changelog()] == [
        "releases are [Unreleased], then [X.Y.Z] - DATE, newest first", "not one line for one change",
        "pyproject.toml's fallback_version is not 0.1.0"]
