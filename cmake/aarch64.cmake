# Toolchain of scripts/arm64_common.sh: 64-bit ARM, against Debian's packages unpacked in GYRO_DEBLUR_SYSROOT. Tests run
# in qemu-user, as the processor that the environment variable QEMU_CPU names.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES GYRO_DEBLUR_SYSROOT)
set(CMAKE_SYSROOT ${GYRO_DEBLUR_SYSROOT})
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64-static -L ${GYRO_DEBLUR_SYSROOT})
# The build folder: genmsg looks there for the messages of this package. Programs (Python, genmsg's dependencies) are
# those of the host.
set(CMAKE_FIND_ROOT_PATH ${GYRO_DEBLUR_SYSROOT} ${CMAKE_BINARY_DIR})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
