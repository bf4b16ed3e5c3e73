#!/usr/bin/env bash
# Runs the paper's experiments: installs what is missing, builds the programs in build/run_all, measures, draws. Tables,
# CSV, JSON and plots go to build/run_all/results. --quick: less of everything.
#
#   experiments/run_all.sh [--quick] [--seed N] [--out DIR] [--data DIR] [--programs DIR]
#
#   --data DIR      recorded data, see test/data/README.md; where it is absent, photographs of opencv-doc take its place
#   --programs DIR  programs that are built already: nothing is installed or built
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/../scripts/common.sh"
readonly STEPS=7

quick=()
seed=1
out="${GYRO_DEBLUR_BUILD}/run_all/results"
data="${GYRO_DEBLUR_ROOT}/../shared/data"
programs=''
while (($# > 0)); do
  case "$1" in
    --quick) quick=(--quick) ;;
    --seed | --out | --data | --programs)
      (($# > 1)) || fail "$1 needs a value; see --help"
      case "$1" in
        --seed) seed="$2" ;;
        --out) out="$(realpath -m "$2")" ;;
        --data) data="$(realpath -m "$2")" ;;
        --programs) programs="$(realpath "$2")" ;;
      esac
      shift
      ;;
    *) fail "unknown argument $1; see --help" ;;
  esac
  shift
done
[[ "${seed}" =~ ^[0-9]+$ ]] || fail "--seed ${seed} is no whole number of 0 or above"
cd "${GYRO_DEBLUR_ROOT}"

step ${STEPS} "Packages"
if [[ -n "${programs}" ]]; then
  say "skipped"
else
  scripts/install_dependencies.sh build experiments
fi

step ${STEPS} "Build"
if [[ -n "${programs}" ]]; then
  say "skipped: programs of ${programs}"
else
  # A folder of its own: no ROS and no tests are needed, and nothing of build/ is configured anew.
  build="${GYRO_DEBLUR_BUILD}/run_all"
  mkdir -p "${build}"
  launcher=()
  if command -v ccache > /dev/null; then
    launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
  fi
  cmake -S . -B "${build}" "${launcher[@]}" -DCMAKE_BUILD_TYPE=RelWithDebInfo -DGYRO_DEBLUR_ROS=OFF \
    -DGYRO_DEBLUR_TESTS=OFF -DGYRO_DEBLUR_EXPERIMENTS=ON > "${build}/configure.log" 2>&1 ||
    { cat "${build}/configure.log" >&2; fail "cmake failed; the output is above"; }
  cmake --build "${build}" --parallel "$(nproc)" --target experiments
  programs="${build}/experiments"
fi

mkdir -p "${out}"
started="${SECONDS}"
times="${out}/times.md"
printf '| stage | time | processor time |\n| --- | --- | --- |\n' > "${times}"
ticks="$(getconf CLK_TCK)"

# Processor time of the ended children of this shell, user and system, in seconds; see proc(5).
processor_s() {
  local stat fields
  read -r stat < "/proc/$$/stat"
  read -ra fields <<< "${stat##*) }"
  echo $(((fields[13] + fields[14]) / ticks))
}

# timed NAME COMMAND...: runs it; a line on the screen and in times.md says what it took.
timed() {
  local name="$1" begin="${SECONDS}" processor_begin status=0 wall processor
  processor_begin="$(processor_s)"
  shift
  "$@" || status=$?
  wall=$((SECONDS - begin))
  processor=$(($(processor_s) - processor_begin))
  say "took ${wall} s, ${processor} s of processor time"
  printf '| %s | %d min %02d s | %d s |\n' "${name}" $((wall / 60)) $((wall % 60)) "${processor}" >> "${times}"
  return "${status}"
}

step ${STEPS} "Figure: deconvolution in space and in the frequency domain"
timed deconvolution "${programs}/deconvolution_figure" --out "${out}" --data "${data}" --seed "${seed}" "${quick[@]}"

step ${STEPS} "Figure: synthetic blur"
timed "synthetic blur" "${programs}/synthetic" --out "${out}" --data "${data}" --seed "${seed}" "${quick[@]}"

step ${STEPS} "Table: bursts with real hand-shake"
timed "real-world table" /usr/bin/python3 experiments/real_world.py "${out}/real_world" \
  --program "${programs}/real_world" --data "${data}" --seed "${seed}" "${quick[@]}"

step ${STEPS} "Figure: reconstruction"
status=0
timed reconstruction /usr/bin/python3 experiments/reconstruction.py "${out}/reconstruction" \
  --program "${programs}/reconstruction" --seed "${seed}" "${quick[@]}" || status=$?
# 77: there is no COLMAP, and the program has said so.
((status == 0 || status == 77)) || fail "the reconstruction failed with status ${status}"

step ${STEPS} "Report"
timed report /usr/bin/python3 experiments/report_experiments.py "${out}"
printf '\n'
cat "${times}"
printf '\n'
say "took $(((SECONDS - started) / 60)) min $(((SECONDS - started) % 60)) s; results: ${out}"
