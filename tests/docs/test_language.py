"""The pages that a person reads: words, length of sentences, length of pages. `docs/generated` comes from the code."""

import re
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.support.words import IN_PAGES, WORDS, compiled, lix

DOCS = ROOT / "docs"
EVIDENCE = sorted((DOCS / "evidence").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", ROOT / "firmware_protocol.md",
         *sorted(DOCS.glob("*.md")), *EVIDENCE]
GUIDE = [DOCS / f"{name}.md" for name in re.findall(
    r"^[a-z]+$", (DOCS / "index.md").read_text(encoding="utf-8").split(":caption: Guide")[1].split("```")[0],
    re.MULTILINE)]

ALLOWED: dict[str, tuple[str, ...]] = {}
"""Page and the phrases in it that keep such a word: a quotation, or the ordinary meaning."""

LONGEST_SENTENCE, MOST_LIX = 30, 32.0
WORDS_OF_GUIDE, PAGES_OF_GUIDE, WORDS_OF_PAGE = 18_000, 12, 2_200
WORDS_OF = {"README.md": 700, "docs/decisions.md": 2_500, "docs/positions.md": 2_200}
PROSE_OF_EVIDENCE = 400


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def prose(page: str) -> str:
    """The page without blocks of code and formulas, tables, headings, pictures, code and addresses of links."""
    page = re.sub(r"^```.*?^```|\$\$.*?\$\$|<!--.*?-->", "", page, flags=re.DOTALL | re.MULTILINE)
    lines = [line for line in page.splitlines() if not line.startswith(("|", "#", "!", "    "))]
    page = re.sub(r"`[^`]*`|\$[^$]*\$", "`CODE`", "\n".join(lines))
    return re.sub(r"\]\([^)]*\)", "]", page)


def sentences(page: str) -> list[str]:
    """The sentences of all paragraphs and items of lists."""
    out: list[str] = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.|:)\s)", prose(page)):
        out += re.split(r"(?<=[.!?:;])[*\")]*\s+(?=[*\"(\[]*[A-Z0-9`\"])", " ".join(block.split()))
    return out


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_uses_the_textbook_s_words(page: Path) -> None:
    text = re.sub(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", "", page.read_text(encoding="utf-8"),
                  flags=re.DOTALL | re.MULTILINE)
    if page.parent.name == "evidence" and page.stem != "index":  # its tables quote messages
        text = re.sub(r"^\|.*$", "", text, flags=re.MULTILINE)
    for phrase in ALLOWED.get(name_of(page), ()):
        assert phrase in text, f"{phrase!r} is allowed and not there"
        text = text.replace(phrase, "")
    found = [f"{match[0]!r} -> {better}" for word, better in compiled(WORDS | IN_PAGES)
             for match in word.finditer(" ".join(text.split()))]
    assert found == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_sentence_is_longer_than_thirty_words(page: Path) -> None:
    assert [s for s in sentences(page.read_text(encoding="utf-8")) if len(s.split()) > LONGEST_SENTENCE] == []


@pytest.mark.parametrize("page", [ROOT / "README.md", *GUIDE, DOCS / "positions.md"], ids=name_of)
def test_a_page_of_the_guide_reads_easily(page: Path) -> None:
    assert lix(sentences(page.read_text(encoding="utf-8"))) < MOST_LIX


def test_a_hard_page_is_seen() -> None:
    hard = ("Candidates imitated by nominal parameters except for insignificant information contributions, "
            "notwithstanding considerable individual likelihood improvements, necessitate comparison.")
    assert lix([hard]) > 60.0 and lix(["The fit does not converge.", "Give more runs of it."]) < 30.0


def test_the_guide_is_short() -> None:
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in GUIDE}
    assert 0 < len(words) <= PAGES_OF_GUIDE
    assert {page: n for page, n in words.items() if n > WORDS_OF_PAGE} == {}
    assert sum(words.values()) <= WORDS_OF_GUIDE


@pytest.mark.parametrize("page", WORDS_OF)
def test_other_pages_are_short(page: str) -> None:
    assert len((ROOT / page).read_text(encoding="utf-8").split()) <= WORDS_OF[page]


@pytest.mark.parametrize("page", EVIDENCE, ids=name_of)
def test_a_page_of_evidence_is_a_screen_of_prose_and_tables(page: Path) -> None:
    assert len(prose(page.read_text(encoding="utf-8")).split()) <= PROSE_OF_EVIDENCE


def test_the_changelog_has_releases_with_a_line_for_each_change() -> None:
    """Newest first, and the newest is what a build without a tag calls itself."""
    head, *releases = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert head.startswith("# Changelog") and releases[0].startswith("[Unreleased]\n")
    dated = [re.match(r"\[(\d+)\.(\d+)\.(\d+)\] - (\d{4}-\d\d-\d\d)\n", text) for text in releases[1:]]
    assert all(dated) and len(dated) >= 2
    order = [(*map(int, match.groups()[:3]), match[4]) for match in dated if match]
    assert order == sorted(order, reverse=True)
    lines = [line for text in releases for line in text.splitlines()[1:] if line]
    assert [line for line in lines if not re.match(r"### (Added|Changed|Fixed|Removed)$|- .{10,136}$", line)] == []
    newest = ".".join(map(str, order[0][:3]))
    assert f'fallback_version = "{newest}' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_checks_can_fail() -> None:
    page = f"A mended page. A {'word ' * 31}end.\n\n| table {'word ' * 40}|\n\n```sh\n{'code ' * 40}\n```\n"
    assert [len(s.split()) for s in sentences(page) if s] == [3, 33]
    assert any(word.search(page) for word, _ in compiled(WORDS | IN_PAGES))
