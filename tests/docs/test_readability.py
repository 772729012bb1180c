"""How hard the guide, the README and the messages are to read, by the library `readability`.

LIX (Björnsson, 1968) is the number of words a sentence plus the percentage of words with more than six letters: 30 is
easy, 40 a newspaper, 50 hard.
"""

import re
from pathlib import Path

import pytest

from tests.docs.test_language import GUIDE, name_of, sentences
from tests.support.paths import ROOT
from tests.test_words import FILES, said_in

readability = pytest.importorskip("readability")
MOST_OF_A_PAGE, MOST_OF_MESSAGES = 32.0, 24.0
PARTS = r"(?<=[.:;!?])\s+|\n\s*\n|\n\s*[-*|]"
"""Between the sentences of a message."""


def lix(texts: list[str]) -> float:
    """Of sentences, without code and numbers."""
    words = [re.findall(r"[A-Za-z][A-Za-z'-]*", text.replace("`CODE`", "it")) for text in texts]
    lines = [" ".join(sentence) for sentence in words if len(sentence) > 2]  # shorter ones are items and labels
    return float(readability.getmeasures(lines, lang="en")["readability grades"]["LIX"])


@pytest.mark.parametrize("page", [ROOT / "README.md", *GUIDE], ids=name_of)
def test_a_page_of_the_guide_reads_easily(page: Path) -> None:
    assert lix(sentences(page.read_text(encoding="utf-8"))) < MOST_OF_A_PAGE


def test_messages_read_easily() -> None:
    assert lix([part for path in FILES for one in said_in(path) if one.kind == "message"
                for part in re.split(PARTS, one.text)]) < MOST_OF_MESSAGES


def test_a_hard_page_is_seen() -> None:
    hard = ("Candidates imitated by nominal parameters except for insignificant information contributions, "
            "notwithstanding considerable individual likelihood improvements, necessitate comparison.")
    assert lix([hard]) > 60.0 and lix(["The fit does not converge.", "Give more runs of it."]) < 30.0
