#!/usr/bin/env python3
"""What a run of ctest comes to: skipped tests with their reasons, what failed tests said last, and as the last line the
numbers of passed, failed and skipped tests. The cases of a GoogleTest binary are counted one by one; another test, and
a binary that did not end by itself, is one, and each case that a test in Python skips is one more. A binary that ran no
case, or did not run all of them, has failed, and so has a test that ctest did not come to. Fails when no test ran."""

import argparse
import collections
import re
import sys

LAST_LINES = 60  # of a failed test


class Test:
    """One test of ctest's: its name, its status ("Passed", "Failed", "Skipped", "Timeout", ...) and its output."""

    def __init__(self, name, status, output):
        self.name = name
        self.failed = status not in ("Passed", "Skipped")
        self.skipped = status == "Skipped"
        self.output = output

    def numbers(self, pattern):
        """Of each line that begins so, its number."""
        return [int(match.group(1)) for match in map(re.compile(pattern).match, self.output) if match]

    def counts(self):
        """Passed, failed, skipped."""
        if self.numbers(r"\[={10}\] (\d+) tests? from .* ran\."):
            passed, failed, skipped = (sum(self.numbers(pattern)) for pattern in (
                r"\[  PASSED  \] (\d+) tests?\.", r"\[  FAILED  \] (\d+) tests?, listed below",
                r"\[  SKIPPED \] (\d+) tests?, listed below"))
            nothing_ran = passed + failed + skipped == 0
            return passed, max(failed, int(self.failed or nothing_ran)), skipped
        ended_early = bool(self.numbers(r"\[={10}\] Running (\d+) tests? from "))
        cases, skipped = self.numbers(r"Ran (\d+) tests? in "), self.skipped_in_python()
        nothing_ran = bool(cases) and sum(cases) + skipped == 0
        failed = self.failed or ended_early or nothing_ran
        all_skipped = self.skipped or (skipped > 0 and sum(cases) <= skipped)
        return int(not failed and not all_skipped), int(failed), max(skipped, int(self.skipped))

    def skipped_in_python(self):
        """Cases that unittest skipped."""
        return sum(self.numbers(r"OK \(.*skipped=(\d+)"))

    def skipped_names(self):
        cases = [match.group(1) for match in map(re.compile(r"\[  SKIPPED \] (\S+) \(\d+ ms\)").match, self.output)
                 if match]
        if self.skipped_in_python() > 0:
            cases.append("%s: %d of its cases" % (self.name, self.skipped_in_python()))
        return cases or ([self.name] if self.skipped else [])

    def reasons(self):
        """The lines below "FILE:LINE: Skipped", GoogleTest's, and "SKIPPED:", of tests in Python; unittest's reasons."""
        for line, following in zip(self.output, self.output[1:]):
            of_unittest = re.search(r"\.\.\. skipped (['\"])(.*)\1$", line)
            if of_unittest:
                yield of_unittest.group(2)
            elif line.endswith(": Skipped") or line == "SKIPPED:":
                yield following


def read_tests(progress, record):
    """Tests of ctest's own lines of progress and its record LastTest.log, both as lists of lines; and how many tests
    ctest did not come to."""
    statuses, total = {}, None
    for line in progress:
        match = re.match(r" *\d+/(\d+) Test +#(\d+): (.+?) \.{2,} *(?:\*\*\*)?([A-Z]\w+)", line)
        if match and total in (None, match.group(1)):  # another total: of a ctest that a failed test ran
            total = match.group(1)
            statuses[match.group(2)] = match.group(3, 4)
    outputs, name = {}, None
    for before, line in zip(record, record[1:]):
        begin = re.match(r"\d+/\d+ Testing: (.+)$", line)
        if begin:
            name = begin.group(1)
            outputs.pop(name, None)  # of a run before, with --repeat
        elif line == "<end of output>":
            name = None
        elif before == "Output:" and name not in outputs:  # the line below it is a rule
            outputs[name] = []
        elif name in outputs:
            outputs[name].append(line)
    tests = [Test(name, status, outputs.get(name, [])) for name, status in statuses.values()]
    return tests, int(total or 0) - len(tests)


def summary(tests):
    """The lines to print, counts aside."""
    lines = []
    skipped = [name for test in tests for name in test.skipped_names()]
    if skipped:
        lines += ["", "Skipped tests and why:", *("  " + name for name in skipped)]
        reasons = collections.Counter(reason for test in tests for reason in test.reasons())
        lines += ["  %7d %s" % (count, reason) for reason, count in reasons.most_common()]
    failed = [test for test in tests if test.counts()[1] > 0]
    if failed:
        lines += ["", "Failed tests, the end of what each said:"]
        for test in failed:
            lines += ["  " + line for line in [test.name + ":", *test.output[-LAST_LINES:]]]
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("progress", help="what ctest printed")
    parser.add_argument("record", help="Testing/Temporary/LastTest.log of the build folder")
    arguments = parser.parse_args()
    logs = []
    for path in (arguments.progress, arguments.record):
        with open(path, errors="replace") as log:
            logs.append(log.read().splitlines())
    tests, not_run = read_tests(*logs)
    if not tests:
        sys.exit("error: %s has no test" % arguments.progress)
    print("\n".join(summary(tests)))
    if not_run > 0:
        print("\nctest ended before %d of its tests, which count as failed" % not_run)
    passed, failed, skipped = (sum(numbers) for numbers in zip(*(test.counts() for test in tests)))
    print(passed, failed + not_run, skipped)


if __name__ == "__main__":
    main()
