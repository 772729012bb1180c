"""What a page would fetch or run."""

import base64
import hashlib
import re
from html.parser import HTMLParser


class Outside(HTMLParser):
    """Collects what would make a browser fetch or run something."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.scripts = 0
        """Elements that a browser would run, if the page's policy lets it."""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "script" and dict(attrs).get("type") != "application/json":
            self.scripts += 1
        if tag in ("link", "iframe", "img", "object", "embed", "base", "form"):
            self.found.append(tag)
        for name, value in attrs:
            if name.startswith("on"):
                self.found.append(name)
            if name in ("src", "href", "xlink:href", "action", "data") and not (value or "").startswith("#"):
                self.found.append(f"{name}={value}")


def allowed_script(page: str) -> str:
    """The script of a page whose policy allows it by its hash, and no other."""
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    (allowed,) = re.findall(r"script-src ([^;]*)", policy)
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert allowed == f"'sha256-{digest}'" and "default-src 'none'" in policy
    return str(script)
