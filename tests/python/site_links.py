"""Links of a built book (`mdbook build`) that lead nowhere within it: files that are not there, anchors that no page has.

    python site_links.py SITE

Exit code: 0 all lead somewhere, 1 not, or there are none.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# made for any folder, or of all pages together
OTHERS = ("404.html", "print.html", "toc.html")


class Page(HTMLParser):
    """Anchors and links of a page."""

    def __init__(self, path):
        super().__init__()
        self.names, self.links = set(), []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        for key, value in attributes:
            if key in ("id", "name") and value:
                self.names.add(value)
            if key in ("href", "src") and value:
                self.links.append(value)


def main(site):
    pages = {path: Page(path) for path in site.rglob("*.html")}
    seen, lost = 0, []
    for path, page in pages.items():
        for link in page.links if path.name not in OTHERS else ():
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            seen += 1
            to = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            is_inside = to.is_relative_to(site) and to.exists()
            if not is_inside or (parts.fragment and to in pages and unquote(parts.fragment) not in pages[to].names):
                lost.append(f"{path.relative_to(site)}: {link}")
    print("\n".join(lost + [f"{len(pages)} pages, {seen} links, {len(lost)} lead nowhere"]))
    return bool(lost) or not seen


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve()))
