#!/usr/bin/env bash
# Extended tests, in build/extended_tests: every test of the package itself, nodelets included, under AddressSanitizer
# and UndefinedBehaviorSanitizer, those of what works with threads and the fault table under ThreadSanitizer, the fuzz
# targets for a minute each, the soak for ten minutes of simulated time, the long tests (label long), and the C++ tests
# on 64-bit ARM in emulation (scripts/arm64.sh, four hours). Fails when one of them finds something, or a test hangs.
# --quick, as in continuous integration: the tests of test/sanitized_tests.txt without UndefinedBehaviorSanitizer's
# checks of pointers, no fault table, fuzzers for 10 s each, 20 reloads of the nodelet, the soak for a minute, no long
# tests, no ARM.
#
#   scripts/extended_tests.sh [--quick] [--within MINUTES] [--only asan|tsan|fuzz|soak|long|arm64]...
#
#   --within MINUTES  after that time a build is broken off and no test or fuzzer begun; the status is 77 then, unless
#                     something has failed. The next run goes on where this ended.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"

fuzz_s=60
soak_s=600
minutes=0
quick=false
only=()
while (($# > 0)); do
  case "$1" in
    --quick)
      quick=true
      fuzz_s=10
      soak_s=60
      export GYRO_DEBLUR_RELOADS=20
      ;;
    --within)
      [[ "${2:-}" =~ ^[1-9][0-9]*$ ]] || fail "--within takes a number of minutes"
      minutes="$2"
      shift
      ;;
    --only)
      [[ "${2:-}" =~ ^(asan|tsan|fuzz|soak|long|arm64)$ ]] || fail "--only takes asan, tsan, fuzz, soak, long or arm64"
      only+=("$2")
      shift
      ;;
    *) fail "unknown argument $1; see --help" ;;
  esac
  shift
done
if ((${#only[@]} == 0)); then
  only=(asan tsan fuzz soak)
  "${quick}" || only+=(long arm64)
fi
wanted() { [[ " ${only[*]} " == *" $1 "* ]]; }
readonly STEPS=$((1 + ${#only[@]}))
# As of a skipped test of ctest's.
readonly NOT_DONE=77
# The slowest tests under AddressSanitizer, of the timing and of the engine, take six to nine minutes with one more test on
# two cores, fourteen with two more. What takes twice as long waits for something that does not come.
readonly TEST_LIMIT_S=1800
deadline=$((minutes > 0 ? EPOCHSECONDS + 60 * minutes : 0))
readonly deadline
out_of_time() { ((deadline > 0 && EPOCHSECONDS >= deadline)); }

end_when_out_of_time() {
  if out_of_time; then
    say "not done within ${minutes} minutes"
    exit ${NOT_DONE}
  fi
}

step ${STEPS} "Packages"
scripts/install_dependencies.sh build extended
source_system_ros

export ASAN_OPTIONS=detect_leaks=1:strict_string_checks=1:allocator_may_return_null=1
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS="suppressions=${GYRO_DEBLUR_ROOT}/scripts/lsan.supp:print_suppressions=0"
# Libraries of others are not instrumented: what happens inside them is left out.
export TSAN_OPTIONS=halt_on_error=1:second_deadlock_stack=1:ignore_noninstrumented_modules=1

# A devel space in use would give instrumented programs its own libraries.
libraries=()
IFS=: read -r -a folders <<< "${LD_LIBRARY_PATH:-}"
for folder in "${folders[@]}"; do
  [[ -e "${folder}/libgyro_deblur_core.so" ]] || libraries+=("${folder}")
done
LD_LIBRARY_PATH="$(IFS=:; echo "${libraries[*]}")"
export LD_LIBRARY_PATH

# configure FOLDER ARGUMENTS...: libraries several files at a time, which saves a sixth of the time.
configure() {
  local folder="$1"
  shift
  local launcher=()
  if command -v ccache > /dev/null; then
    launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
  fi
  mkdir -p "${folder}"
  cmake -S . -B "${folder}" "${launcher[@]}" -DGYRO_DEBLUR_FAST_BUILD=ON -DCMAKE_UNITY_BUILD=ON \
    -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1" \
    -DCMAKE_CXX_COMPILER=clang++ -DPYTHON_EXECUTABLE=/usr/bin/python3 -DPython3_EXECUTABLE=/usr/bin/python3 "$@" \
    > "${folder}/configure.log" 2>&1 || { cat "${folder}/configure.log" >&2; fail "cmake failed"; }
}

# make_targets FOLDER TARGETS...
make_targets() {
  local folder="$1" now="${EPOCHSECONDS}" begin="${SECONDS}" limit=()
  shift
  end_when_out_of_time
  if ((deadline > now)); then
    limit=(timeout --kill-after=10 $((deadline - now)))
  fi
  "${limit[@]}" cmake --build "${folder}" --parallel "$(build_jobs)" --target "$@" > "${folder}/build.log" 2>&1 || {
    end_when_out_of_time
    tail -n 40 "${folder}/build.log" >&2
    fail "the build failed; its log is ${folder}/build.log"
  }
  say "built, $((SECONDS - begin)) s"
}

# limited LOG COMMAND...: runs it, with its output in LOG; says so when it fails, or hangs.
limited() {
  local log="$1" begin="${EPOCHSECONDS}"
  local name="${log##*/}"
  name="${name%.log}"
  shift
  # In the foreground, so that an interrupt from the keyboard reaches it.
  timeout --foreground --kill-after=10 "${TEST_LIMIT_S}" "$@" > "${log}" 2>&1 && return
  tail -n 60 "${log}" >&2
  if ((EPOCHSECONDS - begin >= TEST_LIMIT_S)); then
    echo "error: ${name} hangs, has not ended within ${TEST_LIMIT_S} s; its log is ${log}" >&2
  else
    echo "error: ${name} failed; its log is ${log}" >&2
  fi
  return 1
}

# with_master FOLDER COMMAND...: with a ROS master of its own.
with_master() {
  local folder="$1" port
  shift
  port="$(/usr/bin/python3 -c 'import socket; s = socket.socket(); s.bind(("localhost", 0)); print(s.getsockname()[1])')"
  (
    export ROS_MASTER_URI="http://localhost:${port}" ROS_HOSTNAME=localhost ROS_LOG_DIR="${folder}/ros_log"
    mkdir -p "${ROS_LOG_DIR}"
    roscore -p "${port}" > "${folder}/roscore.log" 2>&1 < /dev/null &
    master=$!
    trap 'kill -INT "${master}" 2> /dev/null; wait "${master}"' EXIT
    # roscpp waits for the master.
    "$@"
  )
}

# run_test FOLDER BINARY[=FILTER]: leaves no log when the time is over before it begins. FILTER: as of --gtest_filter.
# test_nodelet_faults loads the nodelets into itself, so that they are watched as it is.
run_test() {
  local name="${2%%=*}"
  local log="$1/${name}.log" command=("$1/devel/lib/gyro_deblur/${name}")
  [[ "$2" != *=* ]] || command+=(--gtest_filter="${2#*=}")
  rm -f "${log}"
  if out_of_time; then
    return
  elif [[ "${name}" == test_nodelet_faults ]]; then
    # env.sh: where pluginlib finds this folder's nodelets.
    with_master "$1" limited "${log}" "$1/devel/env.sh" "${command[@]}"
  else
    limited "${log}" "${command[@]}"
  fi
}

# run_fuzzer FOLDER NAME: leaves no log when the time is over before it begins. The corpus in the repository is read,
# what is new goes into the build folder.
run_fuzzer() {
  local log="$1/fuzz_$2.log" results="${GYRO_DEBLUR_BUILD}/extended_tests"
  rm -f "${log}"
  if out_of_time; then
    return
  fi
  mkdir -p "${results}/corpus/$2"
  limited "${log}" "$1/devel/lib/gyro_deblur/fuzz_$2" -max_total_time="${fuzz_s}" -timeout=20 -rss_limit_mb=3000 \
    -malloc_limit_mb=2000 -max_len=4096 -print_final_stats=1 -artifact_prefix="${results}/found_$2_" \
    "${results}/corpus/$2" "${GYRO_DEBLUR_ROOT}/fuzz/corpus/$2"
}

# at_a_time NUMBER FUNCTION FOLDER ARGUMENTS...: calls FUNCTION FOLDER ARGUMENT for each, so many at a time.
at_a_time() {
  local number="$1" function="$2" folder="$3"
  shift 3
  # A failure does not stop the others: xargs ends with it when all have ended.
  # shellcheck disable=SC2016
  printf '%s\n' "$@" | xargs -P "${number}" -I{} bash -c '"$@"' bash "${function}" "${folder}" {}
}
# For the shells that xargs starts.
export TEST_LIMIT_S GYRO_DEBLUR_ROOT GYRO_DEBLUR_BUILD deadline fuzz_s
export -f out_of_time limited with_master run_test run_fuzzer

# run_tests FOLDER BINARIES[=FILTER]...: each as one process; prints how many cases passed.
run_tests() {
  local folder="$1" name passed total=0 begin="${SECONDS}"
  shift
  # One more than there are cores: test_nodelet_faults mostly waits.
  at_a_time $(($(nproc) + 1)) run_test "${folder}" "$@" || fail "some of the tests failed: see above"
  for name in "${@%%=*}"; do
    [[ -f "${folder}/${name}.log" ]] || end_when_out_of_time
    passed="$(sed -n 's/^\[  PASSED  \] \([0-9]*\) test.*/\1/p' "${folder}/${name}.log")"
    ((${passed:-0} > 0)) || fail "${name} ran no test; its log is ${folder}/${name}.log"
    total=$((total + passed))
    say "${name}: ${passed} cases clean"
  done
  say "${total} cases in $# binaries clean, $((SECONDS - begin)) s"
}

# want_leaks FOLDER: fails when leaks of the package's own in parallel loops are not reported.
want_leaks() {
  local log="$1/leak_in_parallel.log" found
  "$1/devel/lib/gyro_deblur/leak_in_parallel" > "${log}" 2>&1 && fail "leaks in a parallel loop are not reported"
  found="$(sed -n 's/^SUMMARY: .* leaked in \([0-9]*\) allocation(s).*/\1/p' "${log}")"
  # Of 100; the address of the last one of each thread may lie about somewhere.
  ((${found:-0} >= 90)) || fail "of 100 leaks in a parallel loop ${found:-none} are reported; see ${log}"
  say "leak_in_parallel: ${found} of 100 leaks reported, as it has to be"
}

command -v clang++ > /dev/null || fail "there is no clang++"
asan_folder="${GYRO_DEBLUR_BUILD}/extended_tests/asan"
fuzzers=(config_yaml calibration_yaml bag_messages image_header exposure)
if wanted asan || wanted fuzz; then
  # The checks of each pointer (null, alignment, object-size, pointer-overflow, vptr) double the time that it takes to
  # compile expressions of Eigen's, and find little that AddressSanitizer does not: only with all tests.
  undefined=undefined
  if "${quick}"; then
    undefined=bool,bounds,builtin,enum,integer-divide-by-zero,nonnull-attribute,return,returns-nonnull-attribute
    undefined+=,shift,signed-integer-overflow,unreachable
  fi
  configure "${asan_folder}" -DGYRO_DEBLUR_FUZZERS=ON -DGYRO_DEBLUR_SANITIZE="address,float-cast-overflow,${undefined}"
fi

# What the package's tests are: a new one is among them, other than those of recorded data and of experiments. Those of
# a nodelet want a master, and only one of them loads it into its own process. Those of deblur_bag start it on bags,
# whose messages the fuzz target bag_messages goes through.
mapfile -t test_sources < <(printf '%s\n' test/*/test_*.cpp |
  grep -v -E '^test/(data|experiments)/|/test_(nodelet|nodelet_faults|deblur_bag|deblur_bag_pictures)\.cpp$')
asan_tests=() tsan_tests=()
while read -r name sanitizer left_out; do
  declare -n sanitized="${sanitizer}_tests"
  sanitized+=("${name}=-${left_out}")
done < <(grep -v -E '^ *(#|$)' test/sanitized_tests.txt)
if ! "${quick}"; then
  mapfile -t asan_tests < <(basename -s .cpp "${test_sources[@]}")
  # And each test that has threads of its own.
  mapfile -t tsan_tests < <({
    printf '%s\n' "${tsan_tests[@]%%=*}"
    grep -l '#include <thread>' "${test_sources[@]}" | xargs basename -s .cpp
  } | sort -u)
fi

if wanted asan; then
  step ${STEPS} "AddressSanitizer and UndefinedBehaviorSanitizer: ${#asan_tests[@]} tests, nodelets"
  # First, as it takes longest.
  asan_tests=(test_nodelet_faults "${asan_tests[@]}")
  make_targets "${asan_folder}" "${asan_tests[@]%%=*}" leak_in_parallel
  want_leaks "${asan_folder}"
  run_tests "${asan_folder}" "${asan_tests[@]}"
fi

if wanted tsan; then
  step ${STEPS} "ThreadSanitizer: ${#tsan_tests[@]} tests, nodelets"
  # First, as it takes longest.
  tsan_tests=(test_nodelet_faults "${tsan_tests[@]}")
  tsan_folder="${GYRO_DEBLUR_BUILD}/extended_tests/tsan"
  configure "${tsan_folder}" -DGYRO_DEBLUR_SANITIZE=thread
  make_targets "${tsan_folder}" "${tsan_tests[@]%%=*}"
  run_tests "${tsan_folder}" "${tsan_tests[@]}"
  if ! "${quick}"; then
    make_targets "${tsan_folder}" fault_table
    limited "${tsan_folder}/fault_table.log" "${tsan_folder}/devel/lib/gyro_deblur/fault_table" --seconds 1 --reloads 5 \
      --quiet || exit 1
    say "fault_table, with a thread for each stream: clean"
  fi
fi

if wanted fuzz; then
  step ${STEPS} "libFuzzer: ${fuzz_s} s for each target"
  make_targets "${asan_folder}" "${fuzzers[@]/#/fuzz_}"
  at_a_time "$(nproc)" run_fuzzer "${asan_folder}" "${fuzzers[@]}" || fail "a fuzzer found something: see above"
  for name in "${fuzzers[@]}"; do
    log="${asan_folder}/fuzz_${name}.log"
    [[ -f "${log}" ]] || end_when_out_of_time
    say "${name}: $(sed -n 's/^stat::number_of_executed_units: *//p' "${log}") inputs, clean"
  done
fi

if wanted soak; then
  step ${STEPS} "Soak: ${soak_s} s of simulated time"
  scripts/build.sh --target soak
  results="${GYRO_DEBLUR_BUILD}/extended_tests"
  mkdir -p "${results}"
  "${GYRO_DEBLUR_BUILD}/devel/lib/gyro_deblur/soak" --seconds "${soak_s}" --json "${results}/soak.json"
  /usr/bin/python3 scripts/soak_plot.py "${results}/soak.json" "${results}/soak.png"
  say "plot: ${results}/soak.png"
fi

if wanted long; then
  step ${STEPS} "Long tests"
  scripts/build.sh
  (source_devel_space && cd "${GYRO_DEBLUR_BUILD}" && ctest --output-on-failure --no-tests=error --parallel "$(nproc)" -L '^long$')
fi

if wanted arm64; then
  step ${STEPS} "64-bit ARM, in emulation"
  end_when_out_of_time
  scripts/arm64.sh
fi
