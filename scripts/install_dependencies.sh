#!/usr/bin/env bash
# Installs the packages that the given groups of work need, or all groups. Does nothing when they are there.
# Debian 12 and 13: from the lists below. Ubuntu 20.04 with ROS noetic in /opt/ros: what package.xml names through
# rosdep, the rest from the lists below. The group benchmark needs no ROS, and no rosdep.
#
#   scripts/install_dependencies.sh [--list] [build] [demo] [test] [extended] [package] [benchmark] [experiments]
#                                   [arm64]
#
#   --list  prints the names of the packages instead, one a line
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

list=false
if [[ "${1:-}" == --list ]]; then
  list=true
  shift
fi

# Named differently, or on Ubuntu by package.xml.
if [[ -d /opt/ros/noetic ]]; then
  rosdep=true
  ros_build_packages=()
  ros_demo_packages=()
  ros_test_packages=(python3-catkin-lint)
  sanitizer_packages=(clang)  # with its run-time libraries
else
  rosdep=false
  ros_build_packages=(
    catkin rosbash ros-core-dev ros-core-python-dev
    libdiagnostic-updater-dev libdynamic-reconfigure-config-init-mutex-dev libimage-transport-dev libnodelet-dev
    libnodeletlib-dev libnodeletlib-tools librosbag-dev librostest-dev libtf2-msgs-dev libtf2-dev libtopic-tools-dev
    pluginlib-dev python3-dynamic-reconfigure
  )
  ros_demo_packages=(python3-rosbag rviz)
  ros_test_packages=(catkin-lint python3-rostest)
  sanitizer_packages=(clang libclang-rt-dev)
fi

# All that the core, its tools and benchmarks need: no ROS. Also what configuring needs for the tests' targets: one
# configuration serves the demo and the tests.
core_packages=(
  ca-certificates cmake g++ git make
  libboost-program-options-dev libeigen3-dev libgtest-dev libopencv-dev libyaml-cpp-dev nlohmann-json3-dev
  ocl-icd-opencl-dev opencl-headers zlib1g-dev
)
build_packages=("${core_packages[@]}" "${ros_build_packages[@]}")
# Of the report scripts. The nodelet, the launch files and the tools do without.
report_packages=(imagemagick python3-matplotlib python3-numpy python3-opencv python3-tqdm)
# rviz is drawn by Mesa in software on a virtual display.
demo_packages=(libgl1-mesa-dri xvfb "${report_packages[@]}" "${ros_demo_packages[@]}")
# The tests run the demo's tools and reports too, and the experiments on photographs of opencv-doc.
test_packages=(
  "${demo_packages[@]}" "${ros_test_packages[@]}"
  clang-format codespell colmap opencv-doc pocl-opencl-icd python3-pil python3-yaml snakemake
)
extended_packages=("${test_packages[@]}" "${sanitizer_packages[@]}")
package_packages=(dpkg-dev file)
benchmark_packages=("${core_packages[@]}" libbenchmark-dev opencv-doc pocl-opencl-icd python3-matplotlib)
# OpenBLAS matches features for the reconstruction.
experiments_packages=(
  colmap libopenblas0-pthread opencv-doc python3-matplotlib python3-numpy python3-opencv python3-pil
  python3-tqdm python3-yaml
)
arm64_packages=(g++-aarch64-linux-gnu mmdebstrap qemu-user-static)

(($# > 0)) || set -- build demo test extended package benchmark experiments arm64
packages=()
ros=false  # whether a group needs what package.xml names
for group in "$@"; do
  [[ "${group}" == benchmark ]] || ros=true
  case "${group}" in
    build) packages+=("${build_packages[@]}") ;;
    demo) packages+=("${demo_packages[@]}") ;;
    test) packages+=("${test_packages[@]}") ;;
    extended) packages+=("${extended_packages[@]}") ;;
    package) packages+=("${package_packages[@]}") ;;
    benchmark) packages+=("${benchmark_packages[@]}") ;;
    experiments) packages+=("${experiments_packages[@]}") ;;
    arm64) packages+=("${arm64_packages[@]}") ;;
    *) fail "unknown group ${group}; see --help" ;;
  esac
done
mapfile -t packages < <(printf '%s\n' "${packages[@]}" | sort -u)
if "${list}"; then
  printf '%s\n' "${packages[@]}"
  exit 0
fi

as_root() {
  if [[ "$(id -u)" -eq 0 ]]; then
    "$@"
  elif command -v sudo > /dev/null; then
    sudo "$@"
  else
    fail "packages are missing and neither root nor sudo is at hand; run as root: $*"
  fi
}

# Another apt may be at work (unattended upgrades): wait for it.
apt_get() { as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=600 -q "$@"; }

command -v apt-get > /dev/null || fail "this is no Debian: install the packages listed in $0 by other means"

if "${rosdep}" && "${ros}"; then
  command -v rosdep > /dev/null || { apt_get update && apt_get install -y python3-rosdep; }
  [[ -d /etc/ros/rosdep/sources.list.d ]] || as_root rosdep init
  types=(--dependency-types=buildtool --dependency-types=build --dependency-types=build_export
    --dependency-types=buildtool_export --dependency-types=exec)
  [[ " $* " != *" test "* && " $* " != *" extended "* ]] || types+=(--dependency-types=test)
  say "rosdep install --from-paths ${GYRO_DEBLUR_ROOT} ${types[*]}"
  # Noetic has reached its end of life: rosdep leaves it out unless it is asked for, before 0.19 by the first option.
  rosdep update --include-eol-distros --rosdistro noetic
  rosdep install --from-paths "${GYRO_DEBLUR_ROOT}" --ignore-src --default-yes --rosdistro noetic "${types[@]}"
fi

missing=()
for package in "${packages[@]}"; do
  status="$(dpkg-query -W -f '${db:Status-Status}' "${package}" 2> /dev/null || true)"
  [[ "${status}" == installed* ]] || missing+=("${package}")
done
if [[ "${#missing[@]}" -eq 0 ]]; then
  say "all ${#packages[@]} packages are installed"
  exit 0
fi
say "installing ${#missing[@]} packages and what they depend on: ${missing[*]}"
apt_get update
apt_get install -y --no-install-recommends "${missing[@]}"
