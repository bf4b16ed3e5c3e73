#!/usr/bin/env bash
# The whole package at work, with nothing but packages of the distribution: simulates a shaken rolling-shutter camera,
# plays the bag through the nodelet, and leaves pictures and numbers in demo_output/.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
cd "${GYRO_DEBLUR_ROOT}"
(($# == 0)) || fail "takes no arguments"
readonly STEPS=7
readonly OUT="${GYRO_DEBLUR_ROOT}/demo_output"
readonly CONFIG="${GYRO_DEBLUR_ROOT}/config/demo.yaml"

master_pid=''
display_pid=''
launch_pid=''
# Ends what this script started, and only that.
cleanup() {
  local pid
  for pid in ${launch_pid} ${display_pid} ${master_pid}; do
    kill -INT "${pid}" 2> /dev/null || true
    wait "${pid}" 2> /dev/null || true
  done
}
trap cleanup EXIT
trap 'exit 130' INT TERM

# launch LOG ARGUMENTS...: runs demo.launch to its end; shows the end of its log when it fails.
launch() {
  local log="$1"
  shift
  roslaunch --wait gyro_deblur demo.launch "$@" > "${log}" 2>&1 < /dev/null &
  launch_pid=$!
  local status=0
  wait "${launch_pid}" || status=$?
  launch_pid=''
  # A required node that ends well ends the launch, whose own status says nothing then.
  if ((status != 0)) || ! grep -q 'frames came out' "${log}" || grep -q '^play_bag.py: ' "${log}"; then
    tail -n 30 "${log}" >&2
    fail "the launch failed; the log is ${log}"
  fi
  grep -h -E 'frames came out|^screenshot' "${log}" | sed 's/^/  /'
}

step ${STEPS} "Packages"
scripts/install_dependencies.sh build demo

step ${STEPS} "Build"
# What this script runs, and no tests, experiments and other tools; a later scripts/build.sh adds them.
scripts/build.sh --target deblur_node --target gyro_deblur_nodelet --target simulate_bag \
  --target gyro_deblur_generate_messages_py
source_devel_space

step ${STEPS} "Simulate a hand-held rolling-shutter camera with its gyroscope"
rm -rf "${OUT:?}"
mkdir -p "${OUT}"
say "config/scenes/handheld.yaml -> demo_output/input.bag"
rosrun gyro_deblur simulate_bag "${OUT}/input.bag" --scene config/scenes/handheld.yaml --json "${OUT}/simulation.json"

step ${STEPS} "Play it through the nodelet"
# A master of its own, on a port that nobody has, leaves others alone.
port="$(/usr/bin/python3 -c 'import socket; s = socket.socket(); s.bind(("localhost", 0)); print(s.getsockname()[1])')"
export ROS_MASTER_URI="http://localhost:${port}" ROS_HOSTNAME=localhost ROS_LOG_DIR="${OUT}/ros_log"
mkdir -p "${ROS_LOG_DIR}"
roscore -p "${port}" > "${OUT}/roscore.log" 2>&1 < /dev/null &
master_pid=$!
say "roscore on port ${port}"
# At a quarter of its speed: SIFT takes longer for a frame than the camera, and every frame is to be seen deblurred.
launch "${OUT}/nodelet.log" bag:="${OUT}/input.bag" config:="${CONFIG}" record:="${OUT}/output.bag" \
  conductor_args:="--rate 0.25"

step ${STEPS} "Full HD at 30 frames a second"
say "config/scenes/fast_1080p.yaml -> demo_output/full_hd_input.bag"
rosrun gyro_deblur simulate_bag "${OUT}/full_hd_input.bag" --scene config/scenes/fast_1080p.yaml --no-truth --quiet
# Only what is subscribed to is computed: the image, and the blur field that says what happened to it.
launch "${OUT}/full_hd.log" bag:="${OUT}/full_hd_input.bag" config:="${GYRO_DEBLUR_ROOT}/config/default.yaml" \
  record:="${OUT}/full_hd_output.bag" outputs:="deblurred/camera_info blur_field" \
  conductor_args:="--json ${OUT}/full_hd.json"
rm "${OUT}/full_hd_input.bag"

step ${STEPS} "Report"
rosrun gyro_deblur report.py "${OUT}/input.bag" "${OUT}/output.bag" "${OUT}" --title "gyro_deblur: demo" \
  --throughput "${OUT}/full_hd_output.bag" "${OUT}/full_hd.json"

step ${STEPS} "rviz on a virtual display"
# The bag is played until the most blurred frame, which rviz then keeps showing.
duration="$(/usr/bin/python3 - "${OUT}/input.bag" "${OUT}/report.json" << 'PYTHON'
import json, sys
import rosbag
with open(sys.argv[2], encoding="utf-8") as file:
    report = json.load(file)
frame = report["pictures"][0]["frame"] if report["pictures"] else report["frames_in"] - 1
with rosbag.Bag(sys.argv[1]) as bag:
    times = [t.to_sec() for _, _, t in bag.read_messages(topics=["/camera/image_raw"])]
    # Half a frame more, for the gyroscope samples that the frame waits for.
    print("%.3f" % (times[frame] + 0.5 * (times[1] - times[0]) - bag.get_start_time()))
PYTHON
)"
exec 7> "${OUT}/.display"
Xvfb -displayfd 7 -screen 0 1600x1000x24 -nolisten tcp > "${OUT}/xvfb.log" 2>&1 < /dev/null &
display_pid=$!
for _ in $(seq 300); do
  [[ -s "${OUT}/.display" ]] && break
  kill -0 "${display_pid}" 2> /dev/null || fail "Xvfb did not start: see ${OUT}/xvfb.log"
  sleep 0.1
done
display="$(cat "${OUT}/.display")"
[[ -n "${display}" ]] || fail "Xvfb gave no display: see ${OUT}/xvfb.log"
# Qt wants a folder that nobody else may enter; with another one rviz has crashed.
mkdir -m 700 "${OUT}/.runtime"
export DISPLAY=":${display}" LIBGL_ALWAYS_SOFTWARE=1 QT_X11_NO_MITSHM=1 XDG_RUNTIME_DIR="${OUT}/.runtime"
rviz_listeners="--listener /camera/blur_markers=/rviz --listener /camera/blur_overlay=/rviz"
rviz_listeners+=" --listener /camera/image_raw=/rviz --listener /camera/deblurred/image_raw=/rviz"
# At a quarter of its speed: rviz draws on the processor.
launch "${OUT}/rviz.log" bag:="${OUT}/input.bag" config:="${CONFIG}" rviz:=true \
  conductor_args:="--rate 0.25 --duration ${duration} --screenshot ${OUT}/rviz.png ${rviz_listeners}"

printf '\nDone. Look at:\n'
for file in report.md rviz.png plots.png $(cd "${OUT}" && ls frame_*_comparison.png frame_*_crops.png frame_*_overlay.png 2> /dev/null); do
  [[ -s "${OUT}/${file}" ]] || fail "demo_output/${file} was not made"
  say "demo_output/${file}"
done
printf '\n'
sed -n -e '/^## Frames/,/^## Diagnostics/{/^## Diagnostics/d;p}' -e '/^## Throughput/,/^## Pictures/{/^## Pictures/d;p}' "${OUT}/report.md"
