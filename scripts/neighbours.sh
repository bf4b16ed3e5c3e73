#!/usr/bin/env bash
# Measures streams of frames beside other processes, in real time: a busy process on every core, a consumer of frames
# like SLAM, and a second stream. Builds first. Numbers, tables and the plot go to build/neighbours; --update-doc puts
# the tables into doc/reports/neighbours.md and the plot into doc/images as well. Takes about seven minutes. Ends with
# status 77 and no verdict where others use the machine, before or meanwhile. Other arguments go to neighbours (see
# --help).
#
#   scripts/neighbours.sh [--update-doc] [--seconds S] [--only WIDTHxHEIGHT] [--keypoints]
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"

take_update_doc "$@"
scripts/install_dependencies.sh build demo
scripts/build.sh --target neighbours
results="${GYRO_DEBLUR_BUILD}/neighbours"
mkdir -p "${results}"
rm -f "${results}/neighbours.json"
status=0
"${GYRO_DEBLUR_BUILD}/devel/lib/gyro_deblur/neighbours" --json "${results}/neighbours.json" "${arguments[@]}" ||
  status=$?
[[ -f "${results}/neighbours.json" ]] || exit "${status}"
report_arguments=("${results}/neighbours.json" "${results}/neighbours.png" --markdown "${results}/tables.md")
if "${update_doc}" && ((status != 77)); then
  report_arguments+=(--document doc/reports/neighbours.md)
fi
/usr/bin/python3 scripts/neighbours_report.py "${report_arguments[@]}"
if "${update_doc}" && ((status != 77)); then
  cp "${results}/neighbours.png" doc/images/neighbours.png
  say "doc/reports/neighbours.md and doc/images/neighbours.png are new"
fi
say "results: ${results}"
exit "${status}"
