#!/usr/bin/env bash
# Configures and builds into build/, with catkin's devel space in build/devel. Everything, or the targets given by
# --target; other arguments go to cmake. The same whether the clone stands alone or inside a catkin workspace.
#
#   scripts/build.sh [--target NAME]... [-DNAME=VALUE]...
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

targets=()
options=()
while (($# > 0)); do
  case "$1" in
    --target)
      (($# > 1)) || fail "--target wants a name"
      targets+=("$2")
      shift
      ;;
    *) options+=("$1") ;;
  esac
  shift
done

mkdir -p "${GYRO_DEBLUR_BUILD}"
# One build at a time in this folder: the demo and the tests may be started together.
exec 9> "${GYRO_DEBLUR_BUILD}/.lock"
flock 9

source_system_ros

# ROS's Python packages belong to the system's interpreter, which need not be the first python3 in PATH.
arguments=(
  -DPYTHON_EXECUTABLE=/usr/bin/python3
  -DPython3_EXECUTABLE=/usr/bin/python3
)
if command -v ccache > /dev/null; then
  arguments+=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
else
  arguments+=(-DGYRO_DEBLUR_FAST_BUILD=ON)
fi
if [[ "${CI:-}" == true ]]; then
  arguments+=(-DGYRO_DEBLUR_WERROR=ON -DGYRO_DEBLUR_FAST_BUILD=ON)
fi
arguments+=("${options[@]}")

say "cmake -S ${GYRO_DEBLUR_ROOT} -B ${GYRO_DEBLUR_BUILD} ${arguments[*]}"
cmake -S "${GYRO_DEBLUR_ROOT}" -B "${GYRO_DEBLUR_BUILD}" "${arguments[@]}" > "${GYRO_DEBLUR_BUILD}/configure.log" 2>&1 ||
  { cat "${GYRO_DEBLUR_BUILD}/configure.log" >&2; fail "cmake failed; the output is above"; }

show_cmake_warnings "${GYRO_DEBLUR_BUILD}/configure.log"

jobs="$(build_jobs)"
say "building with ${jobs} jobs"
if ((${#targets[@]} > 0)); then
  cmake --build "${GYRO_DEBLUR_BUILD}" --parallel "${jobs}" --target "${targets[@]}"
else
  cmake --build "${GYRO_DEBLUR_BUILD}" --parallel "${jobs}"
fi
say "built; to use it: source ${GYRO_DEBLUR_BUILD}/devel/setup.bash"
