#!/usr/bin/env python3
"""What a run of ctest comes to: skipped tests with their reasons, what failed tests said last, and as the last line the
numbers of passed, failed and skipped tests. The cases of a GoogleTest binary are counted one by one; another test, and a
binary that did not end by itself, is one. Fails when no test ran."""

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

    def counts(self):
        """Passed, failed, skipped."""
        if not any(re.match(r"\[={10}\] \d+ tests? from .* ran\.", line) for line in self.output):
            return int(not self.failed and not self.skipped), int(self.failed), int(self.skipped)
        passed, failed, skipped = (
            sum(int(match.group(1)) for match in map(re.compile(pattern).match, self.output) if match)
            for pattern in (r"\[  PASSED  \] (\d+) tests?\.", r"\[  FAILED  \] (\d+) tests?, listed below",
                            r"\[  SKIPPED \] (\d+) tests?, listed below"))
        return passed, max(failed, int(self.failed)), skipped

    def skipped_names(self):
        cases = [match.group(1) for match in map(re.compile(r"\[  SKIPPED \] (\S+) \(\d+ ms\)").match, self.output)
                 if match]
        return cases or ([self.name] if self.skipped else [])

    def reasons(self):
        """The lines below "FILE:LINE: Skipped", GoogleTest's, and "SKIPPED:", of tests in Python."""
        for line, following in zip(self.output, self.output[1:]):
            if line.endswith(": Skipped") or line == "SKIPPED:":
                yield following


def read_tests(progress, record):
    """Tests of ctest's own lines of progress and its record LastTest.log, both as lists of lines."""
    statuses = {}
    for line in progress:
        match = re.match(r" *\d+/\d+ Test +#\d+: (\S+) \.*\s*(?:\*\*\*)?([A-Z]\w+)", line)
        if match:
            statuses[match.group(1)] = match.group(2)
    outputs, name = {}, None
    for before, line in zip(record, record[1:]):
        begin = re.match(r"\d+/\d+ Testing: (\S+)$", line)
        if begin:
            name = begin.group(1)
        elif line == "<end of output>":
            name = None
        elif before == "Output:" and name not in outputs:  # the line below it is a rule
            outputs[name] = []
        elif name in outputs:
            outputs[name].append(line)
    return [Test(name, status, outputs.get(name, [])) for name, status in statuses.items()]


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
    tests = read_tests(*logs)
    if not tests:
        sys.exit("error: %s has no test" % arguments.progress)
    print("\n".join(summary(tests)))
    print(*(sum(numbers) for numbers in zip(*(test.counts() for test in tests))))


if __name__ == "__main__":
    main()
