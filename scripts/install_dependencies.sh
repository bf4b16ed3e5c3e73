#!/usr/bin/env bash
# Installs the Debian packages that building, testing and the demo need. Does nothing when all of them are there.
# Arguments: further packages, which single commands need.
# Debian 12: from the list below. Where ROS noetic is in /opt/ros: through rosdep, from package.xml.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

build_packages=(
  ca-certificates cmake g++ git make
  libcli11-dev libeigen3-dev libgtest-dev libopencv-dev libyaml-cpp-dev nlohmann-json3-dev
  ocl-icd-opencl-dev opencl-clhpp-headers zlib1g-dev
)
ros_packages=(
  catkin rosbash ros-core-dev ros-core-python-dev
  libcv-bridge-dev libdiagnostic-updater-dev libdynamic-reconfigure-config-init-mutex-dev libimage-transport-dev
  libmessage-filters-dev libnav-msgs-dev libnodelet-dev libnodeletlib-dev libnodeletlib-tools librosbag-dev
  libtf2-msgs-dev libtf2-ros-dev libtopic-tools-dev pluginlib-dev python3-dynamic-reconfigure
)
test_packages=(
  catkin-lint clang clang-format libbenchmark-dev libclang-rt-14-dev libomp-dev librostest-dev pocl-opencl-icd
  python3-rostest python3-yaml snakemake
)
# The simulator's textures come from opencv-doc; rviz is drawn by Mesa in software on a virtual display.
demo_packages=(
  imagemagick libgl1-mesa-dri opencv-doc procps python3-matplotlib python3-numpy python3-opencv python3-pil
  python3-rosbag python3-tqdm rviz x11-apps xauth xvfb
)

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
  (($# == 0)) || apt_get install -y --no-install-recommends "$@"
  exit 0
fi

command -v apt-get > /dev/null || fail "this is no Debian: install the packages listed in $0 by other means"

packages=("${build_packages[@]}" "${ros_packages[@]}" "${test_packages[@]}" "${demo_packages[@]}" "$@")
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
