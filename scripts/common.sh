# shellcheck shell=bash
# Shared by the scripts of this folder: paths, messages, the ROS environment. Sourced, not run.

GYRO_DEBLUR_ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
GYRO_DEBLUR_BUILD="${GYRO_DEBLUR_ROOT}/build"
readonly GYRO_DEBLUR_ROOT GYRO_DEBLUR_BUILD
gyro_deblur_step=0

# step TOTAL TEXT: numbered headline.
step() {
  gyro_deblur_step=$((gyro_deblur_step + 1))
  printf '\n[%d/%d] %s\n' "${gyro_deblur_step}" "$1" "$2"
}

# say TEXT...: one line about what is being done.
say() { printf '  %s\n' "$*"; }

# fail TEXT...: one line on stderr, and the end.
fail() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# show_cmake_warnings LOG: what the package's own CMake files warn of.
show_cmake_warnings() { sed -n '/^CMake Warning at .*(message):$/,/^ *$/p' "$1" >&2; }

# Debian has ROS in /usr, where it needs no set-up; ROS's own packages live in /opt/ros.
source_system_ros() {
  local setup=/opt/ros/noetic/setup.bash
  if [[ -f "${setup}" ]]; then
    set +u
    # shellcheck disable=SC1090
    source "${setup}"
    set -u
  fi
}

# The devel space of this clone, for rosrun, roslaunch and rostest.
source_devel_space() {
  local setup="${GYRO_DEBLUR_BUILD}/devel/setup.bash"
  [[ -f "${setup}" ]] || fail "${setup} is missing: run scripts/build.sh first"
  set +u
  # shellcheck disable=SC1090
  source "${setup}"
  set -u
}

# build_jobs: as many as there are cores and memory for: templates of Eigen and OpenCV take about 1 GiB a compiler.
build_jobs() {
  local cores memory
  cores="$(nproc)"
  memory="$(awk '/MemAvailable/ {print int($2 / 1048576)}' /proc/meminfo)"
  ((memory >= 1)) || memory=1
  printf '%d' $((cores < memory ? cores : memory))
}

# take_update_doc ARGUMENTS...: sets `update_doc`, whether --update-doc is among them, and `arguments`, the others.
# shellcheck disable=SC2034
take_update_doc() {
  local argument
  update_doc=false
  arguments=()
  for argument in "$@"; do
    case "${argument}" in
      --update-doc) update_doc=true ;;
      *) arguments+=("${argument}") ;;
    esac
  done
}

# Every script: -h or --help first prints the comment at its head.
case "${1:-}" in
  -h | --help)
    sed -n '2,/^set /{/^set /d;s/^# \{0,1\}//p}' "$0"
    exit 0
    ;;
esac
