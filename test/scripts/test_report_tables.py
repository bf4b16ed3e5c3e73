#!/usr/bin/env python3
"""scripts/report_tables.py, and that the reports that use it end with one clear line on bad input."""

import argparse
import contextlib
import io
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest
from unittest import mock

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import report_tables  # noqa: E402

TEXT = "no JSON"


class Table(unittest.TestCase):
    def test_compact(self):
        lines = report_tables.table(["", "before", "after"], [["PSNR", "20.27 dB", "24.91 dB"], ["", 0, None]])
        self.assertEqual(lines, ["| | before | after |", "| --- | --- | --- |", "| PSNR | 20.27 dB | 24.91 dB |",
                                 "| | 0 | None |"])

    def test_aligned_columns_are_as_wide_as_their_widest_cell(self):
        self.assertEqual(report_tables.table(["", "5 px"], [["cpu", 12.25], ["opencl", ""]], aligned=True),
                         ["|        | 5 px  |", "| ------ | ----- |", "| cpu    | 12.25 |", "| opencl |       |"])

    def test_titled(self):
        self.assertEqual(report_tables.titled_table("Time:", ["a"], [["long"]]),
                         "Time:\n\n| a    |\n| ---- |\n| long |")

    def test_without_rows_the_header_remains(self):
        self.assertEqual(report_tables.table(["a", "bc"], []), ["| a | bc |", "| --- | --- |"])
        self.assertEqual(report_tables.table(["a", "bc"], [], aligned=True), ["| a | bc |", "| - | -- |"])

    def test_rows_of_another_length_are_refused(self):
        for row in ([], ["x"], ["x", "y", "z"]):
            for aligned in (False, True):
                with self.assertRaisesRegex(ValueError, f"row of {len(row)} cells in a table of 2 columns"):
                    report_tables.table(["a", "b"], [["1", "2"], row], aligned)

    def test_rows_may_come_from_anything_that_can_be_iterated_once(self):
        for aligned in (False, True):
            self.assertEqual(len(report_tables.table(["a", "b"], iter({"x": 1, "y": 2}.items()), aligned)), 4)


class Number(unittest.TestCase):
    def test_digits_and_factor(self):
        self.assertEqual(report_tables.number(2 / 3), "0.7")
        self.assertEqual(report_tables.number(2 / 3, 0), "1")
        self.assertEqual(report_tables.number(2 / 3, 2, 100), "66.67")
        self.assertEqual(report_tables.number(-0.125, 3), "-0.125")
        self.assertEqual(report_tables.number(0), "0.0")

    def test_nothing_is_a_dash(self):
        self.assertEqual(report_tables.number(None, 2, 100), "-")


class BadInput(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = pathlib.Path(folder.name)
        change = mock.patch.object(sys, "argv", ["/somewhere/tool.py"])
        change.start()
        self.addCleanup(change.stop)

    def said(self, action, *arguments):
        """The argument of sys.exit, which goes to stderr and makes the status 1."""
        with self.assertRaises(SystemExit) as ended:
            action(*arguments)
        return ended.exception.code

    def about(self, error):
        def block():
            with report_tables.one_line_about("in.json"):
                raise error

        return self.said(block)

    def test_the_line_names_the_program_and_is_one(self):
        self.assertEqual(self.said(report_tables.fail, "it is\nso"), "tool.py: it is so")

    def test_what_is_wrong_is_said(self):
        self.assertEqual(self.about(KeyError("windows")), "tool.py: in.json: there is no 'windows' in it")
        self.assertEqual(self.about(ValueError("no number\nfar and wide")), "tool.py: in.json: no number far and wide")
        self.assertEqual(self.about(StopIteration()), "tool.py: in.json: StopIteration")
        self.assertEqual(self.about(OSError(13, "Permission denied", "out.png")), "tool.py: out.png: Permission denied")
        self.assertEqual(self.about(OSError("unlike any other")), "tool.py: in.json: unlike any other")

    def test_other_errors_and_good_input_pass(self):
        with self.assertRaises(ZeroDivisionError), report_tables.one_line_about("in.json"):
            raise ZeroDivisionError
        with contextlib.redirect_stderr(io.StringIO()) as stderr, report_tables.one_line_about("in.json"):
            pass
        self.assertEqual(stderr.getvalue(), "")

    def test_json(self):
        path = self.path / "in.json"
        self.assertEqual(self.said(report_tables.read_json, path), f"tool.py: {path}: No such file or directory")
        path.write_text(TEXT)
        self.assertRegex(self.said(report_tables.read_json, path), f"^tool.py: {path}: Expecting value: line 1 ")
        path.write_bytes(b"\xff")
        self.assertRegex(self.said(report_tables.read_json, path), f"^tool.py: {path}: 'utf-8' codec can't decode ")
        path.write_text('{"name": "ä", "values": [1, null]}', encoding="utf-8")
        self.assertEqual(report_tables.read_json(path), {"name": "ä", "values": [1, None]})


class WriteTables(unittest.TestCase):
    def test_goes_where_the_options_say(self):
        with tempfile.TemporaryDirectory() as folder:
            tables, document = (pathlib.Path(folder) / name for name in ("tables.md", "page.md"))
            page = "above\n<!-- tables: begin -->\n\nold\n\n<!-- tables: end -->\nbelow\n"
            document.write_text(page)
            parser = argparse.ArgumentParser()
            report_tables.add_table_arguments(parser)
            report_tables.write_tables(parser.parse_args([]), "tables", "| new |\n")
            self.assertEqual(document.read_text(), page)
            options = parser.parse_args(["--markdown", str(tables), "--document", str(document)])
            report_tables.write_tables(options, "tables", "| new |\n", "\n![plot](plot.png)\n")
            self.assertEqual(tables.read_text(), "| new |\n")
            self.assertEqual(document.read_text(), page.replace("old\n", "| new |\n\n![plot](plot.png)\n"))


class Programs(unittest.TestCase):
    """As a user runs them."""

    def test_bad_json_is_one_line_and_status_1(self):
        for program in ("benchmark_report.py", "contention_report.py", "plot_calibration.py", "soak_plot.py"):
            command = [sys.executable, ROOT / "scripts" / program, "in.json"]
            if program != "benchmark_report.py":
                command.append("out.png")
            with tempfile.TemporaryDirectory() as folder:
                for content, what in ((None, "No such file or directory"), (TEXT, "Expecting value: line 1 "),
                                      (json.dumps({"other": 1}), "there is no '")):
                    with self.subTest(program, content=content):
                        if content is not None:
                            (pathlib.Path(folder) / "in.json").write_text(content)
                        result = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                                universal_newlines=True)
                        self.assertEqual(result.returncode, 1)
                        self.assertTrue(result.stderr.startswith(f"{program}: in.json: {what}"), result.stderr)
                        self.assertEqual(result.stderr.count("\n"), 1, result.stderr)

    def test_the_experiments_have_it_too(self):
        with tempfile.TemporaryDirectory() as folder:
            for content, said in ((None, "{0} holds neither deconvolution.json nor synthetic.json"),
                                  (json.dumps({"other": 1}), "{0}/synthetic.json: there is no 'methods' in it")):
                if content is not None:
                    (pathlib.Path(folder) / "synthetic.json").write_text(content)
                result = subprocess.run([sys.executable, ROOT / "experiments" / "report_experiments.py", folder],
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)
                self.assertEqual(result.returncode, 1)
                self.assertEqual(result.stderr, "report_experiments.py: " + said.format(folder) + "\n")


if __name__ == "__main__":
    unittest.main()
