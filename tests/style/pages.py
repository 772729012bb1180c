"""The pages that a person reads: words, length of sentences, length of pages. `docs/generated` comes from the code."""

import re
from collections.abc import Iterator
from pathlib import Path

from tests.style.vocabulary import IN_PAGES, WORDS, compiled, lix
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
EVIDENCE = sorted((DOCS / "evidence").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", ROOT / "firmware_protocol.md",
         *sorted(DOCS.glob("*.md")), *EVIDENCE]
GUIDE = [DOCS / f"{name}.md" for name in re.findall(
    r"^[a-z]+$", (DOCS / "index.md").read_text(encoding="utf-8").split(":caption: Guide")[1].split("```")[0],
    re.MULTILINE)]

LONGEST_SENTENCE, MOST_LIX = 30, 32.0
WORDS_OF_GUIDE, PAGES_OF_GUIDE, WORDS_OF_PAGE = 18_000, 12, 2_200
WORDS_OF = {"README.md": 700, "docs/decisions.md": 2_500, "docs/positions.md": 2_200}
PROSE_OF_EVIDENCE = 400
EASY = [ROOT / "README.md", *GUIDE, DOCS / "positions.md"]


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
    out = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.|:)\s)", prose(page)):
        out += re.split(r"(?<=[.!?:;])[*\")]*\s+(?=[*\"(\[]*[A-Z0-9`\"])", " ".join(block.split()))
    return out


def wrong_words(page: Path) -> Iterator[str]:
    """Words of a page that no textbook has."""
    text = re.sub(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", "", page.read_text(encoding="utf-8"),
                  flags=re.DOTALL | re.MULTILINE)
    if page.parent.name == "evidence" and page.stem != "index":  # its tables quote messages
        text = re.sub(r"^\|.*$", "", text, flags=re.MULTILINE)
    for word, better in compiled(WORDS | IN_PAGES):
        yield from (f"{match[0]!r} -> {better}" for match in word.finditer(" ".join(text.split())))


def too_much(page: Path) -> Iterator[str]:
    """A page or a sentence that is too long or too hard."""
    text = page.read_text(encoding="utf-8")
    for sentence in sentences(text):
        if len(sentence.split()) > LONGEST_SENTENCE:
            yield f"a sentence of {len(sentence.split())} words: {sentence[:150]!r}"
    words, most = len(text.split()), WORDS_OF.get(name_of(page), WORDS_OF_PAGE if page in GUIDE else None)
    if most and words > most:
        yield f"{words} words; at most {most} are allowed"
    if page in EVIDENCE and len(prose(text).split()) > PROSE_OF_EVIDENCE:
        yield f"{len(prose(text).split())} words of prose; at most {PROSE_OF_EVIDENCE} are allowed"
    if page in EASY and lix(sentences(text)) >= MOST_LIX:
        yield f"LIX {lix(sentences(text)):.1f}; at most {MOST_LIX:g} are allowed"


def changelog() -> Iterator[str]:
    """Releases out of order, or lines that state no change. A build without a tag is called by the newest release."""
    head, *releases = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    release = re.compile(r"\[(\d+)\.(\d+)\.(\d+)\] - (\d{4}-\d\d-\d\d)\n")
    dated = [match for text in releases[1:] if (match := release.match(text))]
    order = [(*map(int, match.groups()[:3]), match[4]) for match in dated]
    if not head.startswith("# Changelog") or not releases[0].startswith("[Unreleased]\n") or \
            len(dated) != len(releases) - 1 or len(dated) < 2 or order != sorted(order, reverse=True):
        yield "releases are [Unreleased], then [X.Y.Z] - DATE, newest first"
    for line in (line for text in releases for line in text.splitlines()[1:] if line):
        if not re.match(r"### (Added|Changed|Fixed|Removed)$|- .{10,136}$", line):
            yield f"not one line for one change: {line[:100]!r}"
    newest = ".".join(map(str, order[0][:3]))
    if f'fallback_version = "{newest}' not in (ROOT / "pyproject.toml").read_text(encoding="utf-8"):
        yield f"pyproject.toml's fallback_version is not {newest}"


def problems() -> Iterator[str]:
    """Every line that `make lint` prints about pages."""
    for page in PAGES:
        yield from (f"{name_of(page)}: {said}" for said in (*wrong_words(page), *too_much(page)))
    words = sum(len(page.read_text(encoding="utf-8").split()) for page in GUIDE)
    if not 0 < len(GUIDE) <= PAGES_OF_GUIDE or words > WORDS_OF_GUIDE:
        yield f"the guide has {len(GUIDE)} pages, {words} words; {PAGES_OF_GUIDE} and {WORDS_OF_GUIDE} are allowed"
    yield from (f"CHANGELOG.md: {said}" for said in changelog())
