#!/usr/bin/env bash
# Plays a simulated recording through every fault and prints what became of the frames; fails when one is lost. Builds
# first. --update-doc puts the table into doc/reports/faults.md; other arguments go to fault_table (see --help).
#
#   scripts/fault_table.sh [--update-doc] [--seconds S] [--reloads N]
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"

take_update_doc "$@"
scripts/install_dependencies.sh build demo
scripts/build.sh --target fault_table
table="${GYRO_DEBLUR_BUILD}/fault_table.md"
"${GYRO_DEBLUR_BUILD}/devel/lib/gyro_deblur/fault_table" --markdown "${table}" "${arguments[@]}"
if "${update_doc}"; then
  sed -i -e '/^<!-- fault table: begin -->$/,/^<!-- fault table: end -->$/{//!d}' \
    -e "/^<!-- fault table: begin -->\$/r ${table}" doc/reports/faults.md
  say "doc/reports/faults.md has the new table"
fi
