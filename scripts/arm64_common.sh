# shellcheck shell=bash
# Shared by what cross-builds for 64-bit ARM, against the arm64 packages of this machine's Debian release: a sysroot of
# them, and how cmake is told. Sourced after common.sh, not run.

# 3 GiB; one run at a time.
ARM64_FOLDER="${GYRO_DEBLUR_BUILD}/arm64"
ARM64_SYSROOT="${ARM64_FOLDER}/sysroot"
readonly ARM64_FOLDER ARM64_SYSROOT

# make_arm64_sysroot: unpacks half a gigabyte of packages, unless they are there.
make_arm64_sysroot() {
  local release packages stamp="${ARM64_SYSROOT}.packages" link target library
  # The release of the compiler on this machine, whose C++ library the sysroot must have.
  release="$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)"
  grep -q '^ID=debian$' /etc/os-release || fail "this is no Debian, whose arm64 packages are needed"
  mkdir -p "${ARM64_FOLDER}"
  # For catkin, which looks for packages below its source space.
  touch "${ARM64_FOLDER}/CATKIN_IGNORE"
  exec 9> "${ARM64_FOLDER}/.lock"
  flock 9
  packages="$(scripts/install_dependencies.sh --list build | paste -s -d ,)"
  if [[ "$(cat "${stamp}" 2> /dev/null)" == "${release} ${packages}" ]]; then
    say "${ARM64_SYSROOT} has the packages"
    return
  fi
  rm -rf "${ARM64_SYSROOT}" "${stamp}"
  mkdir -p "${ARM64_SYSROOT}"
  # Unpacked and not installed: no program of theirs runs. The archive passes through a pipe so that the files belong to
  # the caller in each mode of mmdebstrap's. dpkg-shlibdeps reads in DEBIAN/shlibs which package has a library.
  # shellcheck disable=SC2016
  mmdebstrap --variant=extract --architectures=arm64 --include="${packages}" --format=tar \
    --extract-hook='mkdir "$1/DEBIAN" && for package in "$1"/var/cache/apt/archives/*.deb; do
      dpkg-deb --ctrl-tarfile "${package}" | tar -x -O ./shlibs 2> /dev/null || true
    done > "$1/DEBIAN/shlibs"' "${release}" - \
    2> "${ARM64_FOLDER}/sysroot.log" | tar -x -C "${ARM64_SYSROOT}" --exclude='./dev/*' ||
    { cat "${ARM64_FOLDER}/sysroot.log" >&2; fail "mmdebstrap failed; its output is above"; }
  # An absolute link would lead to this machine's files.
  while IFS=$'\t' read -r link target; do
    ln -sfnr "${ARM64_SYSROOT}${target}" "${ARM64_SYSROOT}/${link}"
  done < <(find "${ARM64_SYSROOT}" -type l -lname '/*' -printf '%P\t%l\n')
  # What update-alternatives would do: OpenCV needs both.
  for library in blas lapack; do
    ln -sfn "${library}/lib${library}.so.3" "${ARM64_SYSROOT}/usr/lib/aarch64-linux-gnu/lib${library}.so.3"
  done
  printf '%s\n' "${release} ${packages}" > "${stamp}"
  say "${ARM64_SYSROOT}: $(du -sh "${ARM64_SYSROOT}" | cut -f 1)"
}

# configure_for_arm64 FOLDER -DNAME=VALUE...: configures a cross-build with ROS and without experiments.
configure_for_arm64() {
  local folder="$1"
  shift
  # The environment may name folders of this machine's packages.
  env -u CMAKE_PREFIX_PATH cmake -S . -B "${folder}" \
    -DCMAKE_TOOLCHAIN_FILE="${GYRO_DEBLUR_ROOT}/cmake/aarch64.cmake" -DGYRO_DEBLUR_SYSROOT="${ARM64_SYSROOT}" \
    -DGYRO_DEBLUR_ROS=ON -DGYRO_DEBLUR_EXPERIMENTS=OFF \
    -DPYTHON_EXECUTABLE=/usr/bin/python3 -DPython3_EXECUTABLE=/usr/bin/python3 "$@"
}
