#!/usr/bin/env python3
"""Checks that every relative link of the Markdown files leads to a file, and its anchor to a heading.

Checks links in Markdown ([text](target), images included) and pages that other files name by their path from the root,
such as doc/guides/slam.md#openvins in a comment. Prints FILE:LINE: what is wrong. Exits with 1 if a link is dead,
else with 0. Links to other sites are not followed. Without FILEs, all files that git tracks are checked.
"""
import argparse
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^ *(```|~~~)")
HEADING = re.compile(r"^ {0,3}#{1,6} +(.*?) *#*$")
# The text of a link may contain an image or code, and may go on in the next line.
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)")
CODE_SPAN = re.compile(r"(`+)(?!`).*?(?<!`)\1(?!`)", re.DOTALL)
PAGE = re.compile(r"\b(?:doc/\w[\w/]*|test/data/README|README|CONTRIBUTING)\.md(?:#[\w-]+)?")
EXTERNAL = re.compile(r"^[a-z][a-z0-9+.-]*:")


def without_code(text):
    """The text with its code blocks and code spans blanked; the lines stay where they are."""
    lines, in_code = [], False
    for line in text.splitlines():
        fence = FENCE.match(line) is not None
        lines.append("" if in_code or fence else line)
        in_code ^= fence
    return CODE_SPAN.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), "\n".join(lines))


def anchors_of(text):
    """The anchors that GitHub gives the headings of a Markdown text, and those of its HTML elements."""
    anchors, in_code = set(re.findall(r"<a (?:id|name)=\"([^\"]+)\"", text)), False
    for line in text.splitlines():
        in_code ^= FENCE.match(line) is not None
        heading = None if in_code else HEADING.match(line)
        if heading is None:
            continue
        title = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading.group(1))
        name = re.sub(r"[^\w\- ]", "", title.replace("`", "").lower()).replace(" ", "-")
        unique, count = name, 0
        while unique in anchors:  # a second heading with the same title
            count += 1
            unique = "%s-%d" % (name, count)
        anchors.add(unique)
    return anchors


def links_of(path, text):
    """Yields (line number, folder that the target is relative to, target) of each link to a file."""
    if path.suffix == ".md":
        text = without_code(text)
        for match in LINK.finditer(text):
            if not EXTERNAL.match(match.group(1)):
                yield text.count("\n", 0, match.start(1)) + 1, path.parent, match.group(1)
        return
    for match in PAGE.finditer(text):
        yield text.count("\n", 0, match.start()) + 1, None, match.group()


def dead_links(paths, root):
    """Lines "FILE:LINE: what is wrong" about the links of the files `paths` inside the folder `root`."""
    anchors, found = {}, []
    for path in paths:
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:  # a picture
            continue
        for line, folder, target in links_of(path, text):
            name, _, anchor = target.partition("#")
            file = ((folder or root) / name) if name else path
            place = "%s:%d" % (path.relative_to(root), line)
            if not file.exists():
                found.append("%s: there is no %s" % (place, target))
            elif anchor and file.suffix == ".md":
                file = file.resolve()
                if file not in anchors:
                    anchors[file] = anchors_of(file.read_text(encoding="utf-8"))
                if anchor not in anchors[file]:
                    found.append("%s: %s has no heading #%s" % (place, name or path.name, anchor))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", metavar="FILE", nargs="*", type=pathlib.Path)
    parser.add_argument("--root", type=pathlib.Path, default=ROOT, help="folder of the repository")
    arguments = parser.parse_args()
    root = arguments.root.resolve()
    paths = [path.resolve() for path in arguments.files]
    if not paths:
        names = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=str(root),
                               check=True, stdout=subprocess.PIPE).stdout.decode()
        paths = [root / name for name in names.split("\0") if name and (root / name).is_file()]
    found = dead_links(paths, root)
    for line in found:
        print(line)
    print("%d files, %d dead links" % (len(paths), len(found)))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
