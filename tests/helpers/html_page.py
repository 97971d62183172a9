"""Reading the project's pages."""

from __future__ import annotations

import base64
import hashlib
import re
from html.parser import HTMLParser

POLICY = "Content-Security-Policy"
VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Tags, ids, references, and the text of the cells of each table; fails on bad nesting."""

    def __init__(self, text: str):
        super().__init__()
        self.open, self.ids, self.references, self.tags = [], [], [], []
        self.tables: dict[str, list[list[str]]] = {}
        self.rows, self.texts, self.cell = [], {}, None
        self.feed(text)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if "id" in attrs:
            self.ids.append(attrs["id"])
        self.references += [v for k, v in attrs.items() if k in ("src", "href", "xlink:href")]
        if tag not in VOID:
            self.open.append((tag, attrs.get("id")))
        if tag == "table":
            self.rows = self.tables.setdefault(attrs.get("id") or attrs.get("class"), [])
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.cell = True

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open, f"closes <{tag}>, which is not open"
        was, _ = self.open.pop()
        assert was == tag, f"<{was}> closed by </{tag}>"
        if tag in ("td", "th"):
            self.cell = None

    def handle_data(self, data):
        if self.cell:
            self.rows[-1][-1] += data
        for _, name in self.open:
            if name:
                self.texts[name] = self.texts.get(name, "") + data

    def column(self, table: str, i: int) -> list[str]:
        """Texts of a column, without the heading's row; short rows are left out."""
        return [" ".join(row[i].split()) for row in self.tables[table][1:] if len(row) > i]


def check_page(text: str) -> None:
    """Fail unless a page is well formed, stands alone and describes its pictures."""
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    inside = {f"#{name}" for name in page.ids}
    assert all(r.startswith("data:") or r in inside for r in page.references)
    assert not {"link", "iframe"} & {tag for tag, _ in page.tags}
    # Numbers of a view, and the one script that draws them: the policy lets no other run.
    data, run = [], []
    for attributes, content in re.findall(r"<script([^>]*)>(.*?)</script>", text, re.DOTALL):
        (data if attributes else run).append(content)
        assert attributes in ("", ' type="application/json"')
    assert len(run) == 1 and all(not set("<>&") & set(d) for d in data)
    policy = next(a["content"] for t, a in page.tags if a.get("http-equiv") == POLICY)
    assert policy.startswith("default-src 'none';") and "script-src 'unsafe" not in policy
    keys = [base64.b64encode(hashlib.sha256(r.encode()).digest()).decode() for r in run]
    assert re.findall(r"script-src 'sha256-([^']+)'", policy) == keys
    assert len(text) < 1_500_000
    assert "url(http" not in text and "@import" not in text
    pictures = [attrs for tag, attrs in page.tags if tag == "svg"]
    assert pictures and all(a["role"] == "img" and len(a["aria-label"]) > 4 for a in pictures)
    sizes = [len(svg) for svg in re.findall(r"<svg .*?</svg>", text, flags=re.DOTALL)]
    assert max(sizes) < 300_000
