# rosrun leaves out everything below PACKAGE/build, so it would not find the tools of a devel space in build/devel.
# Spelled with /./ it does.
_gyro_deblur_spelled="${CATKIN_ENV_HOOK_WORKSPACE%/build/devel}/./build/devel"
case ":${CMAKE_PREFIX_PATH}:" in
  *":${CATKIN_ENV_HOOK_WORKSPACE}:"*)
    _gyro_deblur_after=":${CMAKE_PREFIX_PATH}:"
    _gyro_deblur_before="${_gyro_deblur_after%%":${CATKIN_ENV_HOOK_WORKSPACE}:"*}"
    _gyro_deblur_after="${_gyro_deblur_after#*":${CATKIN_ENV_HOOK_WORKSPACE}:"}"
    CMAKE_PREFIX_PATH="${_gyro_deblur_before#:}${_gyro_deblur_before:+:}${_gyro_deblur_spelled}:${_gyro_deblur_after}"
    CMAKE_PREFIX_PATH="${CMAKE_PREFIX_PATH#:}"
    export CMAKE_PREFIX_PATH="${CMAKE_PREFIX_PATH%:}"
    ;;
esac
unset _gyro_deblur_spelled _gyro_deblur_before _gyro_deblur_after
