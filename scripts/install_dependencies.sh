#!/usr/bin/env bash
# Installs the Debian packages that the given groups of work need, or all groups. Does nothing when they are there.
# Debian 12: from the lists below. Where ROS noetic is in /opt/ros: all groups through rosdep, from package.xml.
#
#   scripts/install_dependencies.sh [build] [demo] [test] [proof] [benchmark] [experiments]
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

# Also what configuring needs for the tests' targets: one configuration serves the demo and the tests.
build_packages=(
  ca-certificates cmake g++ git make
  libboost-program-options-dev libeigen3-dev libgtest-dev libopencv-dev libyaml-cpp-dev nlohmann-json3-dev
  ocl-icd-opencl-dev opencl-clhpp-headers zlib1g-dev
  catkin rosbash ros-core-dev ros-core-python-dev
  libdiagnostic-updater-dev libdynamic-reconfigure-config-init-mutex-dev libimage-transport-dev libnodelet-dev
  libnodeletlib-dev libnodeletlib-tools librosbag-dev librostest-dev libtf2-msgs-dev libtf2-dev libtopic-tools-dev
  pluginlib-dev python3-dynamic-reconfigure
)
# rviz is drawn by Mesa in software on a virtual display.
demo_packages=(
  imagemagick libgl1-mesa-dri python3-matplotlib python3-numpy python3-opencv python3-rosbag python3-tqdm rviz xvfb
)
# The tests run the demo's tools and reports too, and the experiments on photographs of opencv-doc.
test_packages=(
  "${demo_packages[@]}"
  catkin-lint clang-format colmap opencv-doc pocl-opencl-icd python3-pil python3-rostest python3-yaml snakemake
)
proof_packages=("${test_packages[@]}" clang libclang-rt-14-dev)
benchmark_packages=(libbenchmark-dev opencv-doc pocl-opencl-icd python3-matplotlib)
# OpenBLAS matches features for the reconstruction.
experiments_packages=(
  colmap libopenblas0-pthread opencv-doc python3-matplotlib python3-numpy python3-opencv python3-pil
  python3-tqdm python3-yaml
)

(($# > 0)) || set -- build demo test proof benchmark experiments
packages=()
for group in "$@"; do
  case "${group}" in
    build) packages+=("${build_packages[@]}") ;;
    demo) packages+=("${demo_packages[@]}") ;;
    test) packages+=("${test_packages[@]}") ;;
    proof) packages+=("${proof_packages[@]}") ;;
    benchmark) packages+=("${benchmark_packages[@]}") ;;
    experiments) packages+=("${experiments_packages[@]}") ;;
    *) fail "unknown group ${group}; see --help" ;;
  esac
done

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

if [[ -d /opt/ros/noetic ]]; then
  command -v rosdep > /dev/null || apt_get install -y python3-rosdep
  [[ -d /etc/ros/rosdep/sources.list.d ]] || as_root rosdep init
  say "rosdep install --from-paths ${GYRO_DEBLUR_ROOT}"
  rosdep update
  rosdep install --from-paths "${GYRO_DEBLUR_ROOT}" --ignore-src --default-yes --rosdistro noetic
  exit 0
fi

command -v apt-get > /dev/null || fail "this is no Debian: install the packages listed in $0 by other means"

mapfile -t packages < <(printf '%s\n' "${packages[@]}" | sort -u)
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
