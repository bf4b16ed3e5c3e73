#!/usr/bin/env bash
# Cross-builds everything but the experiments for 64-bit ARM, nodelet included, against the arm64 packages of this
# machine's Debian release, and runs the C++ tests in qemu-user, as each of two processors: Cortex-A72 (Raspberry Pi 4)
# and Cortex-A76 (Raspberry Pi 5). Prints how many cases pass on each. Everything lies in build/arm64, 3 GiB; the first
# run downloads half a gigabyte. The tests that are not run are in test/not_emulated_tests.txt, with the reasons.
#
#   scripts/arm64.sh [--cpu NAME]... [--only REGEX]
#
#   --cpu NAME    emulates this processor instead of the two (qemu-aarch64-static -cpu help)
#   --only REGEX  builds and runs only the test programs whose names match, e.g. --only '^test_(base|motion)$'
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
# shellcheck source=scripts/arm64_common.sh
source "${GYRO_DEBLUR_ROOT}/scripts/arm64_common.sh"
cd "${GYRO_DEBLUR_ROOT}"

cpus=()
only=.
while (($# > 0)); do
  case "$1" in
    --cpu)
      [[ -n "${2:-}" ]] || fail "--cpu takes the name of a processor"
      cpus+=("$2")
      shift
      ;;
    --only)
      [[ -n "${2:-}" ]] || fail "--only takes a regular expression"
      only="$2"
      shift
      ;;
    *) fail "unknown argument $1; see --help" ;;
  esac
  shift
done
((${#cpus[@]} > 0)) || cpus=(cortex-a72 cortex-a76)
readonly STEPS=4
readonly FOLDER="${ARM64_FOLDER}"
readonly SYSROOT="${ARM64_SYSROOT}"
readonly PROGRAMS="${FOLDER}/build/devel/lib/gyro_deblur"
readonly NOT_EMULATED=test/not_emulated_tests.txt
# The slowest program takes a quarter of this on a free core.
readonly TEST_LIMIT_S=7200

step ${STEPS} "Packages"
# Those of the build here too: their Python programs generate the messages.
scripts/install_dependencies.sh build arm64

step ${STEPS} "Sysroot"
make_arm64_sysroot

step ${STEPS} "Build"
source_system_ros
launcher=()
if command -v ccache > /dev/null; then
  launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
fi
configure_for_arm64 "${FOLDER}/build" "${launcher[@]}" -DGYRO_DEBLUR_FAST_BUILD=ON > "${FOLDER}/configure.log" 2>&1 ||
  { cat "${FOLDER}/configure.log" >&2; fail "cmake failed; the output is above"; }
show_cmake_warnings "${FOLDER}/configure.log"
mapfile -t programs < <(cmake --build "${FOLDER}/build" --target help | sed -n 's/^\.\.\. \(test_[a-z0-9_]*\)$/\1/p')
mapfile -t wanted < <(printf '%s\n' "${programs[@]}" | grep -E -e "${only}" || true)
((${#wanted[@]} > 0)) || fail "no test program has a name that matches ${only}"
targets=("${wanted[@]}")
[[ "${only}" != . ]] || targets=(all)
begin="${SECONDS}"
cmake --build "${FOLDER}/build" --parallel "$(build_jobs)" --target "${targets[@]}" > "${FOLDER}/build.log" 2>&1 ||
  { tail -n 40 "${FOLDER}/build.log" >&2; fail "the build failed; its log is ${FOLDER}/build.log"; }
say "built ${targets[*]}, $((SECONDS - begin)) s"
# Tests start tools. The kernel starts no program of another processor unless binfmt_misc is set up, which needs root: a
# script takes the place of each tool.
mkdir -p "${FOLDER}/tools"
for program in "${PROGRAMS}"/*; do
  tool="${FOLDER}/tools/${program##*/}"
  if [[ -f "${program}" && "${program}" != */test_* && "$(head -c 4 "${program}")" == $'\x7fELF' ]]; then
    mv "${program}" "${tool}"
    printf '#!/bin/sh\nexec qemu-aarch64-static -L "%s" "%s" "$@"\n' "${SYSROOT}" "${tool}" > "${program}"
    chmod +x "${program}"
  fi
done

step ${STEPS} "Tests as ${cpus[*]}"
# NAME [CASES] of the list: the program, or these cases of it, are left out.
declare -A left_out=()
while read -r name cases; do
  [[ " ${programs[*]} " == *" ${name} "* ]] || fail "${NOT_EMULATED} names ${name}, which is no test program"
  left_out[${name}]="${cases:-*}"
done < <(grep -v -E '^ *(#|$)' "${NOT_EMULATED}")
emulated=() runs=()
for name in "${wanted[@]}"; do
  if [[ "${left_out[${name}]:-}" == '*' ]]; then
    say "${name}: not run, see ${NOT_EMULATED}"
    continue
  fi
  emulated+=("${name}")
  for cpu in "${cpus[@]}"; do
    runs+=("${name} ${cpu} -${left_out[${name}]:-}")
  done
done
((${#emulated[@]} > 0)) || fail "${NOT_EMULATED} leaves out every test program whose name matches ${only}"

# emulate NAME CPU FILTER: runs a test program, says how many cases passed. FILTER: as of --gtest_filter. Each run has a
# folder of its own for temporary files, of which some have the same names in every run.
emulate() {
  local name="$1" cpu="$2" log="${FOLDER}/$2/$1.log" begin="${EPOCHSECONDS}" status=0 passed
  export QEMU_CPU="${cpu}" TMPDIR="${FOLDER}/${cpu}/${name}.tmp"
  rm -rf "${TMPDIR}"
  mkdir -p "${TMPDIR}"
  timeout --foreground --kill-after=10 "${TEST_LIMIT_S}" qemu-aarch64-static -L "${SYSROOT}" \
    "${PROGRAMS}/${name}" --gtest_filter="$3" > "${log}" 2>&1 || status=$?
  rm -rf "${TMPDIR}"
  passed="$(awk '/^\[  PASSED  \]/ {print $4}' "${log}")"
  if ((status != 0 || ${passed:-0} == 0)); then
    tail -n 40 "${log}" >&2
    echo "error: ${name} failed as ${cpu}, status ${status}; its log is ${log}" >&2
    return 1
  fi
  say "${name}: ${passed} cases pass as ${cpu}, $((EPOCHSECONDS - begin)) s"
}
# For the shells that xargs starts.
export FOLDER SYSROOT PROGRAMS TEST_LIMIT_S
export -f emulate say

# A failure does not stop the others: xargs ends with it when all have ended.
# shellcheck disable=SC2016
printf '%s\n' "${runs[@]}" | xargs -P "$(nproc)" -L 1 bash -c 'emulate "$@"' bash ||
  fail "some of the tests failed: see above"
for cpu in "${cpus[@]}"; do
  logs=("${emulated[@]/%/.log}")
  total="$(awk '/^\[  PASSED  \]/ {sum += $4} END {print sum}' "${logs[@]/#/${FOLDER}/${cpu}/}")"
  say "${total} cases of ${#emulated[@]} programs pass as ${cpu}"
done
