#!/usr/bin/env python3
"""Check the documents: lengths, links, anchors and paths, the shape of lab pages, and the openings of doc comments.

Prints one line `file:line: message` for each finding and exits with 1 if there is any. With `--program FILE` it also
checks the commands of README, guides and packaging against the help of that program: verbs and options exist. Standard library only.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent

GUIDE_LINE = 100
GUIDE_TABLE_LINE = 200
GUIDE_LINES = 150
README_LINES = 100
CHANGELOG_LINE = 160
SUMMARY = "docs/SUMMARY.md"

# Folders whose paths in code spans have to exist.
SOURCE_FOLDERS = "src|rpc|pipelines|data-synth|tests|examples|docs|scripts|qgis|benches|fuzz|\\.ci"

# Doc comments that open with a relative pronoun. The ceiling may only fall.
PRONOUN_CEILING = 0
PRONOUN = re.compile(r"^\s*//[/!]\s+(What|That which)\b")

# Phrases that a reader of the field has to read twice, in README and guides.
PHRASES = {
    r"\bthat which\b": "use a noun",
    r"\bwhat of (it|them)\b": "use a noun",
    r"\b(is|are) believed\b": "write 'trusted' or 'used as delivered'",
    r"\bdo(es)? not tell\b": "write 'does not show' or 'is not measurable from'",
    r"\bknow(s)? nothing of\b": "write 'does not depend on' or 'does not contain'",
    r"\bin the mean\b": "write 'on average'",
}

# Rules that a page does not keep yet, as (rule, page). Entries may only go.
NOT_YET = set()


def documents():
    """All Markdown files of the working tree that git does not ignore, relative to the root."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--", "*.md"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode == 0 and listing.stdout:
        names = {name for name in listing.stdout.split("\0") if name}
    else:
        skipped = {"target", "node_modules"}
        names = set()
        for folder, folders, files in os.walk(ROOT):
            folders[:] = [name for name in folders if name not in skipped and not name.startswith(".")]
            names |= {os.path.relpath(os.path.join(folder, name), ROOT) for name in files if name.endswith(".md")}
    return sorted(name for name in names if (ROOT / name).is_file())


def sources():
    """All Rust files of the workspace, relative to the root."""
    found = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in {"target", "corpus"} and not name.startswith(".")]
        found += [os.path.relpath(os.path.join(folder, name), ROOT) for name in files if name.endswith(".rs")]
    return sorted(found)


def prose(text):
    """The numbered lines of a text, with whether each is prose (outside of fenced code)."""
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        fence = line.lstrip().startswith("```")
        fenced ^= fence
        yield number, line, not (fenced or fence)


def expanded(path):
    """A path with one level of braces, as a shell expands it."""
    match = re.match(r"(.*?)\{([^{}]*)\}(.*)$", path)
    if not match:
        return [path]
    return [one for part in match.group(2).split(",") for one in expanded(match.group(1) + part + match.group(3))]


def anchors(text):
    """The anchors of a page's headings, as GitHub and mdBook make them."""
    found = set()
    for _, line, outside in prose(text):
        if outside and line.startswith("#"):
            heading = re.sub(r"\]\([^)]*\)", "]", line.lstrip("#").strip()).lower()
            slug = "".join("-" if c == " " else c for c in heading if c.isalnum() or c in " -_")
            copies = 1
            name = slug
            while name in found:
                name = f"{slug}-{copies}"
                copies += 1
            found.add(name)
        found |= set(re.findall(r'<a (?:id|name)="([^"]+)"', line))
    return found


def targets(line):
    """Targets of the links and pictures of one line."""
    line = re.sub(r"`[^`]*`", "", line)
    yield from re.findall(r"\]\(<?([^)\s>]+)", line)
    yield from re.findall(r"^\s*\[[^\]]+\]:\s*(\S+)", line)
    yield from re.findall(r'<(?:img|a|source)\b[^>]*\b(?:src|href|srcset)="([^"]+)"', line)


class Findings:
    """Findings by rule and page; those of a rule that a page does not keep yet are not reported."""

    def __init__(self):
        self.by_rule = {}

    def add(self, rule, page, line, message):
        self.by_rule.setdefault((rule, page), []).append(f"{page}:{line}: {message}")

    def report(self):
        bad = 0
        for rule in sorted(self.by_rule):
            if rule not in NOT_YET:
                bad += len(self.by_rule[rule])
                print("\n".join(self.by_rule[rule]))
        for rule, page in sorted(NOT_YET - set(self.by_rule)):
            print(f"note: ({rule}, {page}) may leave NOT_YET")
        return bad


def check_links(page, text, findings, cache):
    for number, line, outside in prose(text):
        if not outside:
            continue
        for target in targets(line):
            if re.match(r"[a-z][a-z0-9+.-]*:", target):
                continue
            file, _, fragment = target.partition("#")
            path = (ROOT / page).parent / unquote(file) if file else ROOT / page
            if not path.exists():
                findings.add("link", page, number, f"no such file: {target}")
            elif fragment and path.suffix == ".md":
                if path not in cache:
                    cache[path] = anchors(path.read_text(encoding="utf-8"))
                if unquote(fragment) not in cache[path]:
                    findings.add("link", page, number, f"no such heading: {target}")


def check_paths(page, text, findings, names):
    """Paths in code spans exist: from the root, or as the end of the path of a source file."""
    for number, line, outside in prose(text):
        for span in re.findall(r"`([^`\s]+)`", line) if outside else []:
            path = span.rstrip("/")
            if re.match(rf"({SOURCE_FOLDERS})/[\w.{{}},/-]+$", path):
                for one in expanded(path):
                    if not (ROOT / one).exists():
                        findings.add("path", page, number, f"no such file: {one}")
            elif re.match(r"[\w.{},/-]+\.rs$", path):
                for one in expanded(path):
                    if not any(f"/{name}".endswith(f"/{one}") for name in names):
                        findings.add("path", page, number, f"no such source file: {one}")


def check_guide(page, text, findings):
    lines = text.splitlines()
    if len(lines) > GUIDE_LINES:
        findings.add("length", page, len(lines), f"{len(lines)} lines, at most {GUIDE_LINES}")
    for number, line, outside in prose(text):
        # The target of a link cannot be wrapped.
        shown = re.sub(r"\]\([^)]*\)", "]", line)
        limit = GUIDE_TABLE_LINE if outside and line.startswith("|") else GUIDE_LINE
        if len(shown) > limit:
            findings.add("long line", page, number, f"{len(shown)} characters, at most {limit}")


def check_phrases(page, text, findings):
    for number, line, outside in prose(text):
        for pattern, advice in PHRASES.items():
            match = re.search(pattern, line, re.IGNORECASE)
            if outside and match:
                findings.add("phrase", page, number, f"'{match.group(0)}': {advice}")


def check_changelog(page, text, findings):
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > CHANGELOG_LINE:
            findings.add("long line", page, number, f"{len(line)} characters, at most {CHANGELOG_LINE}")


def check_lab(page, text, findings):
    """A page of the lab opens with a heading and three lines: question, setting, result."""
    head = text.splitlines()[:5]
    for word in ("Question", "Setting", "Result"):
        if not any(line.startswith(f"- **{word}:**") for line in head):
            findings.add("lab", page, 1, f"the first five lines have no '- **{word}:**'")


class Program:
    """The help of a program, asked once for each verb."""

    def __init__(self, path):
        self.path = path
        self.known = {}

    def options(self, verb):
        """Long options of a verb, or none where there is no such verb."""
        if verb not in self.known:
            asked = subprocess.run([self.path, *verb, "--help"], capture_output=True, text=True, check=False)
            self.known[verb] = set(re.findall(r"--[a-z][a-z-]*", asked.stdout)) if asked.returncode == 0 else None
        return self.known[verb]


def check_commands(page, text, findings, program):
    """Commands `heliosplat VERB …` in blocks and spans of code have verbs and options that the program has."""
    commands = []
    pending = ""
    for number, line, outside in prose(text):
        if outside:
            commands += [(number, span) for span in re.findall(r"`(heliosplat [^`]+)`", line)]
        elif line.endswith("\\"):
            pending += line[:-1]
        else:
            commands.append((number, (pending + line).strip()))
            pending = ""
    for number, command in commands:
        match = re.search(r"(?:^|[\s/])heliosplat ([a-z].*)", command)
        if not match:
            continue
        try:
            words = shlex.split(match.group(1).replace("\\|", "|"), comments=True)
        except ValueError:
            continue
        verb = tuple(words[:2]) if words[0] == "rpc" else (words[0],)
        options = program.options(verb)
        if options is None:
            findings.add("command", page, number, f"no such verb: {' '.join(verb)}")
            continue
        for word in words:
            option = word.split("=")[0]
            if re.match(r"--[a-z]", option) and option not in options:
                findings.add("command", page, number, f"{' '.join(verb)} has no option {option}")


def check_summary(pages, findings):
    """The summary of the book lists every page of `docs`."""
    listed = set(targets_of(SUMMARY))
    for page in pages:
        if page.startswith("docs/") and page != SUMMARY and page.removeprefix("docs/") not in listed:
            findings.add("summary", SUMMARY, 1, f"{page} is not listed")


def targets_of(page):
    """All targets of the links of a page."""
    return [target for line in (ROOT / page).read_text(encoding="utf-8").splitlines() for target in targets(line)]


def check_doc_comments():
    opened = []
    for name in sources():
        for number, line in enumerate((ROOT / name).read_text(encoding="utf-8").splitlines(), 1):
            if PRONOUN.match(line):
                opened.append(f"{name}:{number}: a doc comment opens with a relative pronoun")
    if len(opened) > PRONOUN_CEILING:
        print("\n".join(opened[:20]))
        print(f"{len(opened)} doc comments open with 'What' or 'That which', at most {PRONOUN_CEILING}")
        return 1
    if len(opened) < PRONOUN_CEILING:
        print(f"note: PRONOUN_CEILING may fall from {PRONOUN_CEILING} to {len(opened)}")
    return 0


def main():
    findings = Findings()
    cache = {}
    program = Program(sys.argv[2]) if sys.argv[1:2] == ["--program"] and len(sys.argv) == 3 else None
    if len(sys.argv) > 1 and program is None:
        sys.exit("usage: check_documents.py [--program FILE]")
    pages = documents()
    names = sources()
    for page in pages:
        text = (ROOT / page).read_text(encoding="utf-8")
        check_links(page, text, findings, cache)
        if page != "CHANGELOG.md":
            check_paths(page, text, findings, names)
        if page.startswith("docs/guide/"):
            check_guide(page, text, findings)
        if page.startswith("docs/guide/") or page == "README.md":
            check_phrases(page, text, findings)
            if program:
                check_commands(page, text, findings, program)
        if page.startswith("docs/lab/") and page != "docs/lab/README.md":
            check_lab(page, text, findings)
        if page == "README.md" and len(text.splitlines()) > README_LINES:
            findings.add("length", page, README_LINES + 1, f"{len(text.splitlines())} lines, at most {README_LINES}")
        if page == "CHANGELOG.md":
            check_changelog(page, text, findings)
    for path in sorted(filter(Path.is_file, (ROOT / "packaging").rglob("*"))) if program else []:
        # The text is read as one block of code; the first line is a comment.
        check_commands(str(path.relative_to(ROOT)), "```" + path.read_text(encoding="utf-8"), findings, program)
    check_summary(pages, findings)
    bad = findings.report() + check_doc_comments()
    print(f"{len(pages)} documents, {bad} findings")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
