#!/usr/bin/env bash
# Builds a Debian package of the nodelet, the tools and the library in build/package, for the system it runs on, and
# prints its path. Install it with: apt install ./FILE
#
#   scripts/package.sh [--arm64] [--check]
#
#   --arm64  cross-builds it for 64-bit ARM and this release of Debian instead, in build/package_arm64
#   --check  also installs it into a new minimal system in a temporary folder, without these sources, and runs tools,
#            launch files and nodelet there. Needs root, debootstrap and the apt mirror of this machine: skipped, with
#            status 77, where one of them is missing. Half a gigabyte to download, five minutes. With --arm64 it asks
#            apt for the dependencies, looks for all libraries and runs tools in emulation.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
# shellcheck source=scripts/arm64_common.sh
source "${GYRO_DEBLUR_ROOT}/scripts/arm64_common.sh"
cd "${GYRO_DEBLUR_ROOT}"
arm64=false
check=false
while (($# > 0)); do
  case "$1" in
    --arm64) arm64=true ;;
    --check) check=true ;;
    *) fail "unknown argument $1; see --help" ;;
  esac
  shift
done
readonly SKIPPED=77
# Of the bags that the checks simulate.
readonly FRAMES=10
FOLDER="${GYRO_DEBLUR_BUILD}/package"
groups=(build package)
STEPS=2
check_steps=2
if "${arm64}"; then
  FOLDER+=_arm64
  groups+=(arm64)
  STEPS=3
  check_steps=1
fi
"${check}" && ((STEPS += check_steps))
readonly FOLDER STEPS

step ${STEPS} "Packages"
scripts/install_dependencies.sh "${groups[@]}"

if "${arm64}"; then
  step ${STEPS} "Sysroot"
  make_arm64_sysroot
fi

step ${STEPS} "Build"
mkdir -p "${FOLDER}"
source_system_ros
prefix=/usr
[[ ! -d /opt/ros/noetic ]] || prefix=/opt/ros/noetic
# Into the system's own space, to which catkin adds no set-up files then.
options=(-DCMAKE_INSTALL_PREFIX="${prefix}" -DCATKIN_BUILD_BINARY_PACKAGE=ON -DGYRO_DEBLUR_TESTS=OFF)
configure() {
  if "${arm64}"; then
    configure_for_arm64 "${FOLDER}" "${options[@]}"
  else
    cmake -S . -B "${FOLDER}" "${options[@]}" -DGYRO_DEBLUR_ROS=ON -DGYRO_DEBLUR_EXPERIMENTS=OFF \
      -DPYTHON_EXECUTABLE=/usr/bin/python3 -DPython3_EXECUTABLE=/usr/bin/python3
  fi
}
configure > "${FOLDER}/configure.log" 2>&1 ||
  { cat "${FOLDER}/configure.log" >&2; fail "cmake failed; the output is above"; }
show_cmake_warnings "${FOLDER}/configure.log"
cmake --build "${FOLDER}" --parallel "$(build_jobs)" > "${FOLDER}/build.log" 2>&1 ||
  { tail -n 40 "${FOLDER}/build.log" >&2; fail "the build failed; its log is ${FOLDER}/build.log"; }
rm -f "${FOLDER}"/*.deb
# CPack before 3.20 does not pass the folder of the package's own libraries to dpkg-shlibdeps.
libraries="${FOLDER}/devel/lib:${FOLDER}/src${LD_LIBRARY_PATH:+:${LD_LIBRARY_PATH}}"
# dpkg-shlibdeps reads files of other processors with the tools of the one that it is told.
! "${arm64}" || export DEB_HOST_ARCH=arm64
(cd "${FOLDER}" && LD_LIBRARY_PATH="${libraries}" cpack -G DEB) > "${FOLDER}/cpack.log" 2>&1 ||
  { cat "${FOLDER}/cpack.log" >&2; fail "cpack failed; the output is above"; }
deb="$(ls "${FOLDER}"/*.deb)"
say "${deb}"
"${check}" || exit 0

if "${arm64}"; then
  step ${STEPS} "Dependencies, and tools in emulation"
  mmdebstrap --simulate --variant=extract --architectures=arm64 --include="${deb}" \
    "$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)" /dev/null > "${FOLDER}/install.log" 2>&1 ||
    { tail -n 20 "${FOLDER}/install.log" >&2; fail "the package cannot be installed"; }
  say "apt has what it depends on"
  unpacked="$(mktemp -d)"
  trap 'rm -rf "${unpacked}"' EXIT
  dpkg-deb -x "${deb}" "${unpacked}"
  emulate() { qemu-aarch64-static -L "${ARM64_SYSROOT}" -E LD_LIBRARY_PATH="${unpacked}${prefix}/lib" "$@"; }
  for library in "${unpacked}${prefix}"/lib/lib*.so; do
    missing="$(emulate "${ARM64_SYSROOT}/lib/ld-linux-aarch64.so.1" --list "${library}" | grep 'not found' || true)"
    [[ -z "${missing}" ]] || fail "${library##*/} lacks ${missing}"
  done
  say "no library lacks another"
  tools="${unpacked}${prefix}/lib/gyro_deblur"
  emulate "${tools}/simulate_bag" "${unpacked}/in.bag" --frames ${FRAMES} --no-truth --scene config/scenes/handheld.yaml
  emulate "${tools}/deblur_bag" "${unpacked}/in.bag" "${unpacked}/out.bag" --config config/default.yaml \
    --json "${unpacked}/out.json"
  grep -q -E "\"frames_out\": *${FRAMES}\b" "${unpacked}/out.json" || fail "deblur_bag lost images"
  say "simulate_bag and deblur_bag"
  exit 0
fi

step ${STEPS} "A minimal system with the package and without these sources"
skip() {
  printf 'SKIPPED: %s\n' "$*"
  exit ${SKIPPED}
}
[[ "$(id -u)" -eq 0 ]] || skip "only root can make a system"
command -v debootstrap > /dev/null || skip "there is no debootstrap: apt-get install debootstrap"
# shellcheck disable=SC1091
codename="$(source /etc/os-release && echo "${VERSION_CODENAME}")"
# apt and dpkg replace what is in the quotes.
# shellcheck disable=SC2016
mirror="$(apt-get indextargets --format '$(REPO_URI)' "Codename: ${codename}" "Created-By: Packages" | head -n 1)"
[[ -n "${mirror}" ]] || skip "apt names no mirror of ${codename}"
system="$(mktemp -d /var/tmp/gyro_deblur_system.XXXXXX)"
remove_system() {
  umount "${system}/proc" 2> /dev/null || true
  mountpoint -q "${system}/proc" || rm -rf --one-file-system "${system}"
}
trap remove_system EXIT
trap 'exit 130' INT TERM
debootstrap --variant=minbase "${codename}" "${system}" "${mirror}" > "${FOLDER}/debootstrap.log" 2>&1 ||
  { tail -n 20 "${FOLDER}/debootstrap.log" >&2; fail "debootstrap failed"; }
# This machine's way to the mirror.
cp -r /etc/apt/apt.conf.d "${system}/etc/apt/"
cp /etc/resolv.conf /etc/hosts "${system}/etc/"
mount -t proc proc "${system}/proc"
cp "${deb}" "${system}/gyro_deblur.deb"
inside() {
  chroot "${system}" /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive "$@"
}
{
  inside apt-get update && inside apt-get install -y --no-install-recommends /gyro_deblur.deb
} > "${FOLDER}/install.log" 2>&1 ||
  { tail -n 20 "${FOLDER}/install.log" >&2; fail "the package cannot be installed; the log is ${FOLDER}/install.log"; }
# shellcheck disable=SC2016
say "installed in ${codename}: $(inside dpkg-query -W -f '${Package} ${Version}' "$(dpkg-deb -f "${deb}" Package)")"

step ${STEPS} "Tools, launch files and nodelet there"
# attempt TEXT COMMAND: in bash, without sources, display and compiler.
attempt() {
  local log="${FOLDER}/check.log"
  inside bash -c "set -eo pipefail; cd /root; [[ ! -f ${prefix}/setup.bash ]] || source ${prefix}/setup.bash; $2" \
    > "${log}" 2>&1 < /dev/null || { tail -n 30 "${log}" >&2; fail "$1: failed; the log is ${log}"; }
  say "$1"
}
attempt "messages" "rosmsg show gyro_deblur/Exposure && python3 -c 'from gyro_deblur.msg import BlurField'"
attempt "launch files" "for file in ${prefix}/share/gyro_deblur/launch/*.launch; do
  case \${file} in *playback* | *inspect* | *demo*) bag=bag:=/root/in.bag ;; *) bag= ;; esac
  roslaunch --files gyro_deblur \$(basename \${file}) \${bag}
done; roslaunch --nodes gyro_deblur deblur.launch"
attempt "tools" "for tool in calibrate deblur_bag deblur_image make_bag simulate_bag; do
  rosrun gyro_deblur \${tool} --help
done"
attempt "a script without its optional packages names one" \
  "{ rosrun gyro_deblur report.py --help 2>&1 || true; } | grep 'apt-get install python3-'"
attempt "simulate_bag and deblur_bag" "
  rosrun gyro_deblur simulate_bag in.bag --frames ${FRAMES} --no-truth \
    --scene ${prefix}/share/gyro_deblur/config/scenes/handheld.yaml
  rosrun gyro_deblur deblur_bag in.bag out.bag --config ${prefix}/share/gyro_deblur/config/default.yaml --json out.json
  grep -E '\"frames_out\": *${FRAMES}\b' out.json"
attempt "nodelet in a manager, on a bag" "
  export ROS_MASTER_URI=http://localhost:11399 ROS_HOSTNAME=localhost
  roslaunch -p 11399 gyro_deblur playback.launch bag:=/root/in.bag record:=/root/played.bag delay:=0
  rosbag info -y -k topics played.bag | grep -A 2 'topic: /camera/deblurred/image_raw' | grep 'messages: ${FRAMES}\$'"
say "all of it works"
