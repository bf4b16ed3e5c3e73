#!/usr/bin/env python3
"""scripts/test_summary.py, on logs as ctest 3.25 writes them."""

import pathlib
import subprocess
import sys
import tempfile
import unittest

SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "scripts" / "test_summary.py"

PROGRESS = """\
Test project /build
        Start   1: test_passes
  1/6 Test   #1: test_passes ......................   Passed    0.10 sec
  2/6 Test   #2: test_skips .......................   Passed    0.10 sec
  3/6 Test   #3: test_fails .......................***Failed    0.10 sec
[  FAILED  ] 1 test, listed below:
  4/6 Test   #4: test_crashes .....................***Exception: SegFault  0.10 sec
  5/6 Test   #5: scripts.skipped ..................***Skipped   0.10 sec
  6/6 Test   #6: scripts.passes ...................   Passed    0.10 sec

67% tests passed, 2 tests failed out of 6
"""

OUTPUTS = {
    "test_passes": """\
[==========] Running 2 tests from 1 test suite.
[       OK ] A.First (0 ms)
[       OK ] A.Second (0 ms)
[==========] 2 tests from 1 test suite ran. (0 ms total)
[  PASSED  ] 2 tests.""",
    "test_skips": """\
/test/test_skips.cpp:12: Skipped
there is no data
[  SKIPPED ] B.NeedsData (0 ms)
[==========] 3 tests from 2 test suites ran. (0 ms total)
[  PASSED  ] 2 tests.
[  SKIPPED ] 1 test, listed below:
[  SKIPPED ] B.NeedsData""",
    "test_fails": """\
/test/test_fails.cpp:7: Failure
[  FAILED  ] C.First (0 ms)
[==========] 4 tests from 1 test suite ran. (0 ms total)
[  PASSED  ] 3 tests.
[  FAILED  ] 1 test, listed below:
[  FAILED  ] C.First""",
    "test_crashes": """\
[ RUN      ] D.First
[       OK ] D.First (0 ms)
[ RUN      ] D.Second""",
    "scripts.skipped": "SKIPPED:\nthere is no snakemake",
    "scripts.passes": "Ran 7 tests in 0.1s\n\nOK",
}


def record(outputs):
    return "Start testing: today\n" + "".join("""\
----------------------------------------------------------
%d/6 Testing: %s
%d/6 Test: %s
Command: "x"
Output:
----------------------------------------------------------
%s
<end of output>
Test time =   0.10 sec
""" % (i, name, i, name, text) for i, (name, text) in enumerate(outputs.items(), 1))


class Summary(unittest.TestCase):
    def run_script(self, progress, outputs):
        with tempfile.TemporaryDirectory() as folder:
            paths = [pathlib.Path(folder) / name for name in ("progress", "record")]
            paths[0].write_text(progress)
            paths[1].write_text(outputs if isinstance(outputs, str) else record(outputs))
            return subprocess.run([sys.executable, SCRIPT, *paths], capture_output=True, text=True)

    def test_cases_are_counted_and_a_crash_is_one_failure(self):
        result = self.run_script(PROGRESS, OUTPUTS)
        self.assertEqual(result.returncode, 0, result.stderr)
        passed, failed, skipped = map(int, result.stdout.splitlines()[-1].split())
        self.assertEqual((passed, failed, skipped), (2 + 2 + 3 + 0 + 0 + 1, 1 + 1, 1 + 1))

    def test_skipped_tests_have_their_reasons(self):
        lines = self.run_script(PROGRESS, OUTPUTS).stdout.splitlines()
        for line in ("  B.NeedsData", "  scripts.skipped", "        1 there is no data", "        1 there is no snakemake"):
            self.assertIn(line, lines)

    def test_what_failed_tests_said_is_repeated(self):
        lines = self.run_script(PROGRESS, OUTPUTS).stdout.splitlines()
        self.assertIn("  /test/test_fails.cpp:7: Failure", lines)
        self.assertIn("  [ RUN      ] D.Second", lines)
        self.assertNotIn("  [       OK ] A.First (0 ms)", lines)

    def test_a_failure_after_the_last_case_counts(self):
        outputs = dict(OUTPUTS, test_crashes=OUTPUTS["test_passes"])
        self.assertEqual(self.run_script(PROGRESS, outputs).stdout.splitlines()[-1], "10 2 2")

    def test_a_binary_that_runs_no_case_or_not_all_fails(self):
        for output in ("""\
[==========] Running 0 tests from 0 test suites.
[==========] 0 tests from 0 test suites ran. (0 ms total)
[  PASSED  ] 0 tests.""", """\
[==========] Running 2 tests from 1 test suite.
[       OK ] A.First (0 ms)"""):
            with self.subTest(output=output):
                result = self.run_script(PROGRESS, dict(OUTPUTS, test_passes=output))
                self.assertEqual(result.stdout.splitlines()[-1], "6 3 2")
                self.assertIn("  test_passes:", result.stdout.splitlines())

    def test_every_end_but_that_of_passing_and_skipping_is_a_failure(self):
        for status in ("***Timeout  600.01 sec", "***Not Run   0.00 sec", "Subprocess aborted***Exception:   0.10 sec",
                       "***Exception: SegFault  0.10 sec", "***Failed    0.10 sec",
                       "***Failed  Error regular expression found in output. Regex=[x]  0.10 sec"):
            with self.subTest(status=status):
                progress = PROGRESS.replace("  Passed    0.10 sec\n\n67%", status + "\n\n67%")
                self.assertNotEqual(progress, PROGRESS)
                self.assertEqual(self.run_script(progress, OUTPUTS).stdout.splitlines()[-1], "7 3 2")

    def test_tests_that_ctest_did_not_come_to_fail(self):
        progress = "".join(PROGRESS.splitlines(keepends=True)[:4])
        lines = self.run_script(progress, OUTPUTS).stdout.splitlines()
        self.assertEqual(lines[-1], "4 4 1")
        self.assertIn("ctest ended before 4 of its tests, which count as failed", lines)

    def test_cases_that_python_skips_count(self):
        skipped = "test_b (X) ... skipped 'there is no COLMAP'\n\nRan %d in 0.1s\n\nOK (skipped=1)"
        for output, counts in (("test_a (X) ... ok\n" + skipped.replace("%d", "2 tests"), "8 2 3"),
                               (skipped.replace("%d", "1 test"), "7 2 3"),
                               (skipped.replace("%d", "0 tests"), "7 2 3")):  # in setUpClass
            with self.subTest(output=output):
                lines = self.run_script(PROGRESS, dict(OUTPUTS, **{"scripts.passes": output})).stdout.splitlines()
                self.assertEqual(lines[-1], counts)
                self.assertIn("  scripts.passes: 1 of its cases", lines)
                self.assertIn("        1 there is no COLMAP", lines)

    def test_a_test_in_python_without_cases_fails(self):
        outputs = dict(OUTPUTS, **{"scripts.passes": "Ran 0 tests in 0.000s\n\nOK"})
        self.assertEqual(self.run_script(PROGRESS, outputs).stdout.splitlines()[-1], "7 3 2")

    def test_of_repeated_runs_the_last_counts(self):
        again = "  7/6 Test   #3: test_fails .......................   Passed    0.10 sec\n"
        text = record(OUTPUTS) + record({"test_fails": OUTPUTS["test_passes"]})
        self.assertEqual(self.run_script(PROGRESS + again, text).stdout.splitlines()[-1], "7 1 2")

    def test_tests_may_have_the_same_name(self):
        progress = PROGRESS.replace("#6: scripts.passes .", "#6: test_passes ....")
        self.assertEqual(self.run_script(progress, OUTPUTS).stdout.splitlines()[-1], "9 2 2")

    def test_no_test_is_an_error(self):
        result = self.run_script("No tests were found!!!\n", {})
        self.assertNotEqual(result.returncode, 0)
        self.assertIn("has no test", result.stderr)


if __name__ == "__main__":
    unittest.main()
