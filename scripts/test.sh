#!/usr/bin/env bash
# Installs what is missing, builds, checks format, package and documents, and runs the tests. Ends with the line 'N
# passed, N failed, N skipped'. Tests that take minutes (label long) are left out, unless arguments for ctest are
# given: scripts/extended_tests.sh runs them. --extended, first: sanitizers and fuzzers too, after the tests
# (scripts/extended_tests.sh --quick), which count as one test more, and as a skipped one when 75 minutes are over, from
# the beginning, before their last part begins. Further arguments go to ctest.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"
extended=false
if [[ "${1:-}" == --extended ]]; then
  extended=true
  shift
fi
STEPS=6
"${extended}" && STEPS=7
readonly STEPS

# took: what the steps took so far, for those who ask where the time goes.
took() { say "done at minute $((SECONDS / 60)):$(printf '%02d' $((SECONDS % 60)))"; }

step ${STEPS} "Packages"
groups=(build test)
"${extended}" && groups+=(extended)
scripts/install_dependencies.sh "${groups[@]}"
took

step ${STEPS} "Build"
scripts/build.sh
took

failed_checks=()
extended_passed=0
extended_skipped=0

step ${STEPS} "Format"
# Releases of clang-format differ in detail; 14 is Debian 12's.
if clang-format --version 2> /dev/null | grep -q 'version 14\.'; then
  mapfile -t sources < <(git ls-files -- '*.cpp' '*.hpp')
  if clang-format --dry-run --Werror "${sources[@]}"; then
    say "${#sources[@]} files follow .clang-format"
  else
    say "FAILED: run clang-format -i on the files above"
    failed_checks+=("Format")
  fi
else
  say "SKIPPED: there is no clang-format 14"
fi

step ${STEPS} "catkin_lint"
if command -v catkin_lint > /dev/null; then
  # What it cannot know: catkin is optional here, the targets below src/ros are not for others to link, and scripts/
  # is for those who work on the package.
  if catkin_lint --strict -W1 --offline --skip-path build --ignore missing_required --ignore external_directory \
    --ignore external_interface_path --ignore unguarded_test_cmd --ignore unguarded_test_depend \
    --ignore uninstalled_script --ignore immutable_var --ignore env_var "${GYRO_DEBLUR_ROOT}" &&
    catkin_lint --strict -W1 --offline openvins; then
    say "no complaints"
  else
    failed_checks+=("catkin_lint")
  fi
else
  say "SKIPPED: there is no catkin_lint"
fi

step ${STEPS} "Spelling and links"
if command -v codespell > /dev/null; then
  # Not words of English, but right: scripts/spelling_words.txt.
  mapfile -t texts < <(git ls-files -- ':!fuzz/corpus' ':!*.png' ':!scripts/spelling_words.txt')
  if codespell --ignore-words scripts/spelling_words.txt "${texts[@]}"; then
    say "${#texts[@]} files without spelling mistakes"
  else
    say "FAILED: correct the words above, or add them to scripts/spelling_words.txt"
    failed_checks+=("Spelling")
  fi
else
  say "SKIPPED: there is no codespell"
fi
if python3 scripts/check_links.py; then
  say "every relative link and anchor exists"
else
  say "FAILED: correct the links above"
  failed_checks+=("Links")
fi

step ${STEPS} "Tests"
# One run at a time: ctest keeps its record in the build folder.
exec 8> "${GYRO_DEBLUR_BUILD}/.test_lock"
flock 8
log="${GYRO_DEBLUR_BUILD}/ctest.log"
ctest_status=0
# Those that somebody asks for by name are not left out.
chosen=("$@")
if (($# == 0)); then
  chosen=(-LE '^long$')
  export GYRO_DEBLUR_RELOADS="${GYRO_DEBLUR_RELOADS:-50}"
  say "left out: tests with the label long (scripts/extended_tests.sh --only long runs them)"
fi
# The devel space is for these alone: its path of libraries would have the sanitizers' programs load this build's. One
# test more than there are cores: those with a ROS master wait for two thirds of their time.
(source_devel_space && cd "${GYRO_DEBLUR_BUILD}" &&
  ctest --output-on-failure --no-tests=error --parallel "$(($(nproc) + 1))" "${chosen[@]}") 2>&1 |
  tee "${log}" || ctest_status=$?

summary="$(/usr/bin/python3 scripts/test_summary.py "${log}" "${GYRO_DEBLUR_BUILD}/Testing/Temporary/LastTest.log")" ||
  fail "ctest ran no test (status ${ctest_status}); see ${log}"
read -r passed failed skipped <<< "${summary##*$'\n'}"
took

if "${extended}"; then
  step ${STEPS} "Extended tests"
  # Last, so that a slow machine spends its time on the tests first. All takes 43 minutes on two free cores.
  readonly EXTENDED_ENDS_MINUTE=75
  EXTENDED_MINUTES=$((SECONDS / 60 < EXTENDED_ENDS_MINUTE ? EXTENDED_ENDS_MINUTE - SECONDS / 60 : 1))
  readonly EXTENDED_MINUTES
  extended_status=0
  extended_log="${GYRO_DEBLUR_BUILD}/extended_tests.log"
  scripts/extended_tests.sh --quick --within "${EXTENDED_MINUTES}" --only asan --only tsan --only fuzz 2>&1 |
    tee "${extended_log}" || extended_status=$?
  case "${extended_status}" in
    0) extended_passed=1 ;;
    77)
      extended_skipped=1
      say "SKIPPED: not done within ${EXTENDED_ENDS_MINUTE} minutes of all; scripts/extended_tests.sh goes on where this ended"
      ;;
    *) failed_checks+=("Extended tests") ;;
  esac
  took
fi

# Here, where a log that is cut at its beginning still has it.
printf '%s\n' "${summary%$'\n'*}"
if ((${#failed_checks[@]} > 0)); then
  # Once more at the end: often that is all that is kept of a run.
  [[ " ${failed_checks[*]} " != *" Extended tests "* ]] || tail -n 80 "${extended_log}"
  (IFS=, && printf '\nOther checks that failed: %s\n' "${failed_checks[*]}")
fi
printf '\n%d passed, %d failed, %d skipped\n' $((passed + extended_passed)) \
  $((failed + ${#failed_checks[@]})) $((skipped + extended_skipped))
((failed == 0 && ${#failed_checks[@]} == 0 && ctest_status == 0))
