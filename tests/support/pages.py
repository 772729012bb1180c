"""What a page would fetch or run."""

from html.parser import HTMLParser


class Outside(HTMLParser):
    """Collects what would make a browser fetch or run something."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("script", "link", "iframe", "img", "object", "embed", "base", "form"):
            self.found.append(tag)
        for name, value in attrs:
            if name.startswith("on"):
                self.found.append(name)
            if name in ("src", "href", "xlink:href", "action", "data") and not (value or "").startswith("#"):
                self.found.append(f"{name}={value}")
