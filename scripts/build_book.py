#!/usr/bin/env python3
"""Build the site of the documents with mdBook, and check every link of its pages.

usage: build_book.py MDBOOK

Writes docs/book. Files of the repository that pages link to and that are no pages, such as examples, are copied into docs/book/files.
Prints one line for each link without a target and exits with 1 if there is any. Standard library only.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
BOOK = DOCS / "book"
LINK = re.compile(r'\b(href|src)="([^"]+)"')


def copy_repository_files(page):
    """Copies the files outside of `docs` that a page links to, and points the links at the copies."""
    folder = page.relative_to(BOOK).parent

    def target(match):
        source = (DOCS / folder / unquote(match[2])).resolve()
        if re.match(r"[a-z]+:|#|/", match[2]) or DOCS in source.parents or not source.is_file():
            return match[0]
        copy = BOOK / "files" / source.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, copy)
        return f'{match[1]}="{os.path.relpath(copy, page.parent)}"'

    page.write_text(LINK.sub(target, page.read_text(encoding="utf-8")), encoding="utf-8")


def dead_links(page, anchors):
    """The links of a page whose file or heading does not exist."""
    for _, link in LINK.findall(page.read_text(encoding="utf-8")):
        file, _, fragment = link.partition("#")
        # The page of missing pages has the address of the site's root.
        if re.match(r"[a-z]+:", link) or page.name == "404.html":
            continue
        target = (page.parent / unquote(file)).resolve() if file else page
        if target not in anchors and not target.is_file():
            yield f"{page.relative_to(BOOK)}: no such file: {link}"
        elif fragment and target in anchors and unquote(fragment) not in anchors[target]:
            yield f"{page.relative_to(BOOK)}: no such heading: {link}"


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    shutil.rmtree(BOOK, ignore_errors=True)
    subprocess.run([sys.argv[1], "build", DOCS], check=True)
    pages = sorted(BOOK.rglob("*.html"))
    for page in pages:
        copy_repository_files(page)
    anchors = {page: set(re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8"))) for page in pages}
    dead = [fault for page in pages for fault in dead_links(page, anchors)]
    print("\n".join([*dead, f"{len(pages)} pages, {len(dead)} dead links: docs/book/index.html"]))
    return 1 if dead or len(pages) < 30 else 0


if __name__ == "__main__":
    sys.exit(main())
