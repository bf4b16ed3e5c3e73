#!/usr/bin/env python3
"""scripts/check_links.py finds dead links and anchors, and no others."""

import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "check_links.py"
sys.path.insert(0, str(SCRIPT.parent))
import check_links  # noqa: E402

# In two parts: the script reads this file as well.
PAGE = "doc/" + "page.md"
TARGET = """# The `title` of a page, and more

## Again
## Again
## [A link](elsewhere.md) in_a heading: 50 %

```
# not a heading
```

<a name="by-hand"></a>
"""


class CheckLinks(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name).resolve()
        (self.root / "doc").mkdir()
        (self.root / PAGE).write_text(TARGET, encoding="utf-8")

    def dead_links(self, text, name="README.md"):
        path = self.root / name
        path.write_text(text, encoding="utf-8")
        return check_links.dead_links([path], self.root)

    def test_anchors_are_those_of_github(self):
        self.assertEqual(check_links.anchors_of(TARGET), {"the-title-of-a-page-and-more", "again", "again-1",
                                                          "a-link-in_a-heading-50-", "by-hand"})

    def test_links_that_lead_somewhere(self):
        text = "# Top\n[a](%s), [b](%s#again-1), [c\ntext](#top) ![e](doc) [f](https://example.org/missing.md#x)\n"
        self.assertEqual(self.dead_links(text % (PAGE, PAGE)), [])

    def test_a_dead_file(self):
        self.assertEqual(self.dead_links("one\n[two\nlines](missing.md)\n"),
                         ["README.md:3: there is no missing.md"])

    def test_a_dead_picture(self):
        self.assertEqual(self.dead_links("![text](doc/missing.png)"), ["README.md:1: there is no doc/missing.png"])

    def test_a_dead_anchor(self):
        self.assertEqual(self.dead_links("[a](%s#not-a-heading) [b](#top)" % PAGE),
                         ["README.md:1: %s has no heading #not-a-heading" % PAGE,
                          "README.md:1: README.md has no heading #top"])

    def test_links_are_relative_to_their_file(self):
        self.assertEqual(self.dead_links("[a](page.md) [b](../README.md)", "doc/" + "other.md"),
                         ["doc/" + "other.md:1: there is no ../README.md"])

    def test_code_has_no_links(self):
        self.assertEqual(self.dead_links("`[a](missing.md)`\n```\n[b](missing.md)\n```\n"), [])

    def test_pages_that_comments_name(self):
        self.assertEqual(self.dead_links("// see %s#again\n" % PAGE, "a.cpp"), [])
        self.assertEqual(self.dead_links("// see\n// doc/" + "missing.md\n// %s#gone.\n" % PAGE, "a.cpp"),
                         ["a.cpp:2: there is no doc/" + "missing.md", "a.cpp:3: %s has no heading #gone" % PAGE])

    def test_status_and_summary(self):
        for text, status, last in (("[a](%s)" % PAGE, 0, "1 files, 0 dead links"), ("[a](b)", 1, "1 files, 1 dead links")):
            path = self.root / "README.md"
            path.write_text(text, encoding="utf-8")
            result = subprocess.run([sys.executable, str(SCRIPT), "--root", str(self.root), str(path)],
                                    stdout=subprocess.PIPE, universal_newlines=True)
            self.assertEqual(result.returncode, status)
            self.assertEqual(result.stdout.splitlines()[-1], last)


if __name__ == "__main__":
    unittest.main()
