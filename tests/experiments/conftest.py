"""Where commands are typed, and who answers them."""

from pathlib import Path

import pytest

from tests.support.shell import Answers


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own, which is the current one: a command names its files as a user does."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Answers:
    """Says what is answered at a terminal; the questions asked are in the list returned."""
    def give(*texts: str) -> list[str]:
        rest, asked = iter(texts), []

        def answer(question: str = "") -> str:
            asked.append(question)
            for text in rest:
                return text
            raise EOFError

        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        monkeypatch.setattr("builtins.input", answer)
        return asked

    return give
