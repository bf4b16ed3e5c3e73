#!/usr/bin/env bash
# Measures streams of frames under contention, in real time: a busy process on every core, a consumer of frames
# like SLAM, and a second stream. Builds first. Numbers, tables and the plot go to build/contention; --update-doc puts
# the tables into doc/reports/contention.md and the plot into doc/images as well. Takes about seven minutes. Ends with
# status 77 and no verdict where others use the machine, before or meanwhile. Other arguments go to benchmark_contention (see
# --help).
#
#   scripts/benchmark_contention.sh [--update-doc] [--seconds S] [--only WIDTHxHEIGHT] [--keypoints]
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"

take_update_doc "$@"
scripts/install_dependencies.sh build demo
scripts/build.sh --target benchmark_contention
results="${GYRO_DEBLUR_BUILD}/contention"
mkdir -p "${results}"
rm -f "${results}/contention.json"
status=0
"${GYRO_DEBLUR_BUILD}/devel/lib/gyro_deblur/benchmark_contention" --json "${results}/contention.json" "${arguments[@]}" ||
  status=$?
[[ -f "${results}/contention.json" ]] || exit "${status}"
report_arguments=("${results}/contention.json" "${results}/contention.png" --markdown "${results}/tables.md")
if "${update_doc}" && ((status != 77)); then
  report_arguments+=(--document doc/reports/contention.md)
fi
/usr/bin/python3 scripts/contention_report.py "${report_arguments[@]}"
if "${update_doc}" && ((status != 77)); then
  cp "${results}/contention.png" doc/images/contention.png
  say "doc/reports/contention.md and doc/images/contention.png are new"
fi
say "results: ${results}"
exit "${status}"
