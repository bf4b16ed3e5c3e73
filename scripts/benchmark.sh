#!/usr/bin/env bash
# Installs what is missing, builds the measurements in build/measurements, and runs them: ratios between engines, the
# processor's peaks, memory, stages of the pipeline, fidelity and seams, then Google Benchmark's suite. Needs no ROS.
# Tables, JSON and the plot go to build/measurements/results; --update-doc puts the tables into
# doc/reports/performance.md and the plot into doc/images as well. Takes about ten minutes (--quick: two); use a machine
# that does nothing else.
#
#   scripts/benchmark.sh [--quick] [--update-doc] [--skip-suite] [--skip-fidelity]
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"
readonly STEPS=6

quick=false
update_doc=false
suite=true
fidelity=true
for argument in "$@"; do
  case "${argument}" in
    --quick) quick=true ;;
    --update-doc) update_doc=true ;;
    --skip-suite) suite=false ;;
    --skip-fidelity) fidelity=false ;;
    *) fail "unknown argument ${argument}; see --help" ;;
  esac
done

step ${STEPS} "Packages"
scripts/install_dependencies.sh benchmark

step ${STEPS} "Build"
# A folder of its own: no ROS and no tests are needed, and nothing of build/ is configured anew. Not build/benchmark,
# where scripts/build.sh puts what it makes of benchmark/.
build="${GYRO_DEBLUR_BUILD}/measurements"
results="${build}/results"
mkdir -p "${results}"
launcher=()
if command -v ccache > /dev/null; then
  launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
fi
cmake -S . -B "${build}" "${launcher[@]}" -DCMAKE_BUILD_TYPE=RelWithDebInfo -DGYRO_DEBLUR_ROS=OFF \
  -DGYRO_DEBLUR_TESTS=OFF -DGYRO_DEBLUR_EXPERIMENTS=OFF -DGYRO_DEBLUR_BENCHMARKS=ON > "${build}/configure.log" 2>&1 ||
  { cat "${build}/configure.log" >&2; fail "cmake failed; the output is above"; }
cmake --build "${build}" --parallel "$(build_jobs)" --target benchmarks

compare_arguments=()
fidelity_arguments=()
suite_arguments=(--benchmark_min_time=0.2)
if "${quick}"; then
  compare_arguments=(--rounds 7 --sizes 1920x1080 --threads 2)
  fidelity_arguments=(--angle-step 15 --uniform-images 1 --extents 5 15 30 60 90 130)
  suite_arguments=(--benchmark_min_time=0.05
    '--benchmark_filter=blur_field|validation|orb|frame|(cpu-[a-z0-9]*|float)/1920')
fi

step ${STEPS} "Engines, alternating"
"${build}/benchmark/compare_engines" "${compare_arguments[@]}" --json "${results}/compare.json" |
  tee "${results}/compare.txt"

step ${STEPS} "Fidelity and seams"
if "${fidelity}"; then
  "${build}/benchmark/measure_fidelity" "${fidelity_arguments[@]}" --json "${results}/fidelity.json" |
    tee "${results}/fidelity.txt"
else
  say "skipped"
fi

step ${STEPS} "Google Benchmark"
if [[ ! -x "${build}/benchmark/gyro_deblur_benchmark" ]]; then
  say "skipped: Google Benchmark (libbenchmark-dev) is not installed"
elif "${suite}"; then
  "${build}/benchmark/gyro_deblur_benchmark" "${suite_arguments[@]}" \
    --benchmark_out="${results}/suite.json" --benchmark_out_format=json
else
  say "skipped"
fi

step ${STEPS} "Report"
report_arguments=("${results}/compare.json" --plot "${results}/performance.png" --markdown "${results}/tables.md")
if [[ -f "${results}/fidelity.json" ]]; then
  report_arguments+=(--fidelity "${results}/fidelity.json")
fi
if "${update_doc}"; then
  report_arguments+=(--document doc/reports/performance.md)
fi
/usr/bin/python3 scripts/benchmark_report.py "${report_arguments[@]}"
if "${update_doc}"; then
  mkdir -p doc/images
  cp "${results}/performance.png" doc/images/performance.png
  say "doc/reports/performance.md and doc/images/performance.png are new"
fi
say "results: ${results}"
