"""What evaluates a sequence: a SLAM stack by the error of its trajectory, or, without one, the package's own tracks.

An evaluator has a name, reads_tracks (whether it is given feature_tracks, not images), variants (of slam.py's; all
where it has none), the metrics that it gives ({key: (title, digits)}, the first of which decides; less is better),
evaluate(recording, folder, name), which raises Lost, and close(). Another stack is another class here: it gets a bag
with images, or tracks, and an IMU, and its poses of the IMU are compared by state_errors.
"""

import dataclasses
import json
import os
import pathlib
import socket
import subprocess
import sys
import threading
import time

import cv2
import numpy as np
import rosbag

from common import ROOT
from trajectory import Trajectory, absolute_error_m, angle_deg, common, relative_errors, rotations

RELATIVE_SPAN_S = 5.0  # of the pieces of relative errors


@dataclasses.dataclass
class Recording:
    """Images of one camera, its IMU, and what is true."""
    bag: pathlib.Path
    image_topic: str
    imu_topic: str
    shift_s: float       # t_imu = stamp + shift: the instant that an image stands for
    rolling: bool        # rows are exposed one after the other
    camera: dict         # of sequence.json
    imu: dict            # the same
    truth: Trajectory    # of the IMU
    biases: np.ndarray   # true ones, of gyroscope [rad/s] and accelerometer [m/s^2]


def run_logged(command, log, environment=None, timeout_s=1800):
    """Raises RuntimeError with the log's end when the command fails."""
    with open(log, "w", encoding="utf-8") as file:
        status = subprocess.run([str(part) for part in command], stdout=file, stderr=subprocess.STDOUT, check=False,
                                env=environment, timeout=timeout_s).returncode
    if status != 0:
        lines = pathlib.Path(log).read_text(errors="replace").splitlines()
        raise RuntimeError("%s ended with status %d:\n%s" % (command[0], status, "\n".join(lines[-15:])))


class Lost(Exception):
    """The evaluator did its work, and what it was given was too bad for it."""


class Master:
    """A roscore of its own on a free port, for programs that take parameters from one."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.environment = {"ROS_MASTER_URI": "http://127.0.0.1:%d" % port, "ROS_HOSTNAME": "127.0.0.1",
                            "ROS_HOME": str(folder)}
        self._process = subprocess.Popen(["roscore", "-p", str(port)], stdout=subprocess.DEVNULL,
                                         stderr=subprocess.DEVNULL, env=dict(os.environ, **self.environment))
        give_up_s = time.monotonic() + 30
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    return
            if self._process.poll() is not None or time.monotonic() > give_up_s:
                self.end()
                raise RuntimeError("roscore does not answer")
            time.sleep(0.1)

    def end(self):
        self._process.terminate()
        self._process.wait()


def state_errors(estimate, truth):
    """Metrics of a stack's trajectory."""
    estimate, truth = common(estimate, truth)
    return {"ate_m": absolute_error_m(estimate, truth),
            "rte_percent": float(np.mean(relative_errors(estimate, truth, RELATIVE_SPAN_S)))}


class OpenVins:
    """OpenVINS (Geneva et al., ICRA 2020), where the user has built it for ROS 1: its reader of bags. One camera, the
    settings that come with it for EuRoC, but calibrated: it gets the true calibration and estimates none, and it
    starts from the true state, so that all start the same."""

    name = "OpenVINS"
    reads_tracks = False
    metrics = {"ate_m": ("absolute trajectory error [m]", 3),
               "rte_percent": ("error relative to %g s of path [%%]" % RELATIVE_SPAN_S, 2)}
    # Of the recording of the IMU, which is longer than the images; with fewer states it has ended early.
    MIN_COVERED = 0.8

    SETTINGS = {
        "verbosity": "WARNING", "use_fej": True, "integration": "rk4", "use_stereo": False, "max_cameras": 1,
        "calib_cam_extrinsics": False, "calib_cam_intrinsics": False, "calib_cam_timeoffset": False,
        "calib_imu_intrinsics": False, "calib_imu_g_sensitivity": False,
        "max_clones": 11, "max_slam": 50, "max_slam_in_update": 25, "max_msckf_in_update": 40, "dt_slam_delay": 1,
        "gravity_mag": 9.80665, "feat_rep_msckf": "GLOBAL_3D", "feat_rep_slam": "ANCHORED_MSCKF_INVERSE_DEPTH",
        "feat_rep_aruco": "ANCHORED_MSCKF_INVERSE_DEPTH",
        "try_zupt": False, "zupt_chi2_multipler": 0, "zupt_max_velocity": 0.1, "zupt_noise_multiplier": 10,
        "zupt_max_disparity": 0.5, "zupt_only_at_beginning": False,
        "init_window_time": 2.0, "init_imu_thresh": 1.5, "init_max_disparity": 10.0, "init_max_features": 50,
        "init_dyn_use": False, "init_dyn_mle_opt_calib": False, "init_dyn_mle_max_iter": 50,
        "init_dyn_mle_max_time": 0.05, "init_dyn_mle_max_threads": 1, "init_dyn_num_pose": 6,
        "init_dyn_min_deg": 10.0, "init_dyn_inflation_ori": 10, "init_dyn_inflation_vel": 100,
        "init_dyn_inflation_bg": 10, "init_dyn_inflation_ba": 100, "init_dyn_min_rec_cond": 1e-12,
        "init_dyn_bias_g": [0.0, 0.0, 0.0], "init_dyn_bias_a": [0.0, 0.0, 0.0],
        "record_timing_information": False, "record_timing_filepath": "/dev/null",
        "use_klt": True, "num_pts": 200, "fast_threshold": 20, "grid_x": 5, "grid_y": 5, "min_px_dist": 10,
        "knn_ratio": 0.70, "track_frequency": 21.0, "downsample_cameras": False, "num_opencv_threads": 0,
        "histogram_method": "HISTOGRAM", "use_aruco": False, "num_aruco": 1024, "downsize_aruco": True,
        "up_msckf_sigma_px": 1, "up_msckf_chi2_multipler": 1, "up_slam_sigma_px": 1, "up_slam_chi2_multipler": 1,
        "up_aruco_sigma_px": 1, "up_aruco_chi2_multipler": 1, "use_mask": False,
    }

    def __init__(self, devel, folder, changes=None, from_truth=True):
        """devel: the workspace's devel space; folder: for the master's files, and what is built; changes: settings in
        place of those above; from_truth: it starts from the true state, not by itself."""
        self.devel = pathlib.Path(devel).resolve()
        self._changes, self._from_truth = changes or {}, from_truth
        if not (self.devel / "lib" / "ov_msckf" / "ros1_serial_msckf").is_file():
            raise RuntimeError("there is no OpenVINS for ROS 1 in %s" % self.devel)
        self._program = self.program(folder)
        self._master = Master(folder)
        self._lock, self._runs = threading.Lock(), 0

    def program(self, folder):
        """Path of what reads bags."""
        del folder
        return self.devel / "lib" / "ov_msckf" / "ros1_serial_msckf"

    @staticmethod
    def _topics(recording):
        """Its arguments for the bag's topics."""
        return ["_topic_imu:=" + recording.imu_topic, "_topic_camera0:=" + recording.image_topic]

    def close(self):
        self._master.end()

    def environment(self):
        """For programs that use its libraries."""
        libraries = os.pathsep.join(filter(None, [str(self.devel / "lib"), os.environ.get("LD_LIBRARY_PATH", "")]))
        # The matrices are small: threads of the linear algebra would only wait for each other.
        return dict(os.environ, LD_LIBRARY_PATH=libraries, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1",
                    **self._master.environment)

    @staticmethod
    def run(command, states, log, environment):
        """Its states, where it has written some: it crashes, with some releases of its libraries, when it has done its
        work and ends, and ends itself where its covariance breaks down."""
        try:
            run_logged(command, log, environment)
        except RuntimeError:
            if not states.exists():
                raise
        return OpenVins.read_states(states)

    @classmethod
    def write_settings(cls, recording, folder, changes=None):
        """Its three files. Returns the path of the first."""
        camera, imu = recording.camera, recording.imu
        R_imu_cam = np.array(camera["R_cam_imu"]).T
        T_imu_cam = np.vstack([np.column_stack([R_imu_cam, camera["p_imu_cam_m"]]), [0, 0, 0, 1]])
        identity, zero = np.eye(3).tolist(), np.zeros((3, 3)).tolist()
        per_root_hz = 1 / np.sqrt(imu["rate_hz"])
        chain = {"cam0": {"T_imu_cam": T_imu_cam.tolist(), "cam_overlaps": [], "camera_model": "pinhole",
                          "distortion_coeffs": [0.0, 0.0, 0.0, 0.0], "distortion_model": "radtan",
                          "intrinsics": camera["intrinsics"], "resolution": camera["size"],
                          "timeshift_cam_imu": recording.shift_s, "rostopic": recording.image_topic}}
        inertial = {"imu0": {"T_i_b": np.eye(4).tolist(), "accelerometer_noise_density":
                             imu["accel_noise_m_s2"] * per_root_hz, "accelerometer_random_walk": 3.0e-3,
                             "gyroscope_noise_density": imu["gyro_noise_rad_s"] * per_root_hz,
                             "gyroscope_random_walk": 1.9393e-05, "rostopic": recording.imu_topic, "time_offset": 0.0,
                             "update_rate": imu["rate_hz"], "model": "kalibr", "Tw": identity,
                             "R_IMUtoGYRO": identity, "Ta": identity, "R_IMUtoACC": identity, "Tg": zero}}
        settings = dict(cls.SETTINGS, relative_config_imu="imu.yaml", relative_config_imucam="camera.yaml",
                        **(changes or {}))
        for name, content in ("camera.yaml", chain), ("imu.yaml", inertial), ("estimator.yaml", settings):
            # OpenCV reads JSON's notation of values in a file that begins as its YAML does.
            lines = ["%YAML:1.0", ""] + cls._lines(content, 0)
            (folder / name).write_text("\n".join(lines) + "\n")
        return folder / "estimator.yaml"

    @classmethod
    def _lines(cls, content, depth):
        lines = []
        for key, value in content.items():
            if isinstance(value, dict):
                lines += [" " * depth + key + ":"] + cls._lines(value, depth + 2)
            elif isinstance(value, list) and value and isinstance(value[0], list):
                lines += [" " * depth + key + ":"] + [" " * (depth + 2) + "- " + json.dumps(row) for row in value]
            else:
                lines.append(" " * depth + key + ": " + json.dumps(value))
        return lines

    @staticmethod
    def write_start(recording, path):
        """A true state from before the first image, in the clock of the stamps. It starts again with every image that
        was recorded within 0.1 s of one, until it has begun to update, and takes none that is older than its state."""
        with rosbag.Bag(str(recording.bag)) as bag:
            recorded_s = next(bag.read_messages(topics=[recording.image_topic])).timestamp.to_sec()
        before_s, step_s = 0.075, 0.005
        start_s = recorded_s - before_s
        t_s = start_s + recording.shift_s + step_s * np.array([-1, 0, 1])
        before, state, after = ((p, q) for p, q in zip(*dataclasses.astuple(recording.truth.at(t_s))[1:]))
        velocity_m_s = (after[0] - before[0]) / (2 * step_s)
        values = [*state[0], *state[1][[3, 0, 1, 2]], *velocity_m_s, *recording.biases]
        path.write_text("#t,p,q,v,bw,ba\n%.0f,%s\n" % (1e9 * start_s, ",".join("%.9g" % value for value in values)))

    @staticmethod
    def read_states(path):
        """What it writes of every image. Raises Lost when there is nothing."""
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        if len(lines) < 2:
            raise Lost("no states")
        states = np.loadtxt(lines, usecols=range(8))
        # Its quaternions take the world to the body in JPL's convention: the same four numbers as Hamilton's of the
        # body to the world.
        return Trajectory(states[:, 0], states[:, 5:8], states[:, 1:5])

    def estimate(self, recording, folder, name):
        """Its trajectory. Raises RuntimeError when it fails."""
        with self._lock:
            self._runs += 1
            node = "stack_%d" % self._runs
        settings, states = self.write_settings(recording, folder, self._changes), folder / "states.txt"
        command = [self._program, "_config_path:=%s" % settings, "__name:=" + node, "_path_bag:=%s" % recording.bag,
                   *self._topics(recording), "_save_total_state:=true", "_filepath_est:=%s" % states,
                   "_filepath_std:=%s" % (folder / "deviations.txt"), "_filepath_gt:=%s" % (folder / "unused.txt")]
        if self._from_truth:
            self.write_start(recording, folder / "start.csv")
            command.append("_path_gt:=%s" % (folder / "start.csv"))
        return self.run(command, states, folder / (name + ".log"), self.environment())

    def evaluate(self, recording, folder, name):
        return self.errors(self.estimate(recording, folder, name), recording.truth)

    @classmethod
    def errors(cls, estimate, truth):
        covered = np.ptp(estimate.t_s) / np.ptp(truth.t_s)
        if covered < cls.MIN_COVERED:
            raise Lost("states of %.0f %% of the sequence alone" % (100 * covered))
        return state_errors(estimate, truth)


class OpenVinsTracks(OpenVins):
    """OpenVINS as above, on the package's tracks in place of corners of its own."""

    name = "OpenVINS on blur-aware tracks"  # results of the former tracker have another name
    reads_tracks = True
    # Without camera_info there are no tracks.
    variants = ("sharp", "package", "exposure-unknown", "exposure-x0.6", "exposure-x1.6", "camera-info-only", "no-imu")
    SIGMA_PX = 0.5  # standard deviation that it takes corners to have: doc/reports/slam.md
    SETTINGS = {**OpenVins.SETTINGS, "up_msckf_sigma_px": SIGMA_PX, "up_slam_sigma_px": SIGMA_PX}

    @classmethod
    def with_sigma(cls, sigma_px):
        """The same with another standard deviation, under a name of its own."""
        settings = {**cls.SETTINGS, "up_msckf_sigma_px": sigma_px, "up_slam_sigma_px": sigma_px}
        return type(cls.__name__, (cls,), {"name": "%s, %g px" % (cls.name, sigma_px), "SETTINGS": settings})

    def program(self, folder):
        """Built against OpenVINS in a part of the folder."""
        source, build = ROOT / "openvins", folder / "openvins"
        build.mkdir(parents=True, exist_ok=True)
        # ROS wants the distribution's Python, which need not be the first one on the path.
        python = ["-D%s_EXECUTABLE=%s" % (name, sys.executable) for name in ("PYTHON", "Python3")]
        run_logged(["cmake", "-S", source, "-B", build, "-DCMAKE_PREFIX_PATH=%s" % self.devel, *python],
                   folder / "build.log")
        run_logged(["cmake", "--build", build], folder / "build.log")
        return build / "devel" / "lib" / "gyro_deblur_openvins" / "openvins_tracks"

    @staticmethod
    def _topics(recording):
        return ["imu:=" + recording.imu_topic, "feature_tracks:=" + recording.image_topic]


class OwnTracks:
    """Motion of the camera between images from the package's tracks: rotation, and direction of the translation, from
    points of equal weight, and by their covariances."""

    name = "tracks"
    reads_tracks = True
    variants = OpenVinsTracks.variants + ("blurred", "gyroscope")
    metrics = {"direction_deg": ("direction of the translation, median error [degrees]", 2),
               "weighted_direction_deg": ("the same, points weighed by their covariances", 2),
               "rotation_deg": ("rotation, median error [degrees]", 3),
               "weighted_rotation_deg": ("the same, points weighed by their covariances", 3),
               "tracks": ("tracks through six images", 0)}
    APART = 5          # images between the two of a pair
    MIN_TRACKS = 12
    MIN_WAY_M = 0.05   # less determines no direction
    LOST_DEG = 90.0    # of a pair without enough tracks: what a guess would be off
    COVARIANCE = ("covariance_uu_of_point", "covariance_uv_of_point", "covariance_vv_of_point")

    def close(self):
        pass

    @classmethod
    def _points(cls, cloud, focal_px):
        """By id: normalised place, and covariance there."""
        channels = {channel.name: channel.values for channel in cloud.channels}
        uu, uv, vv = (np.array(channels[name]) / focal_px**2 for name in cls.COVARIANCE)
        covariances = np.stack([np.stack([uu, uv], -1), np.stack([uv, vv], -1)], -2)
        return {int(i): (np.array([p.x, p.y]), c)
                for i, p, c in zip(channels["id_of_point"], cloud.points, covariances)}

    def evaluate(self, recording, folder, name):
        del folder
        focal_px = recording.camera["intrinsics"][0]
        with rosbag.Bag(str(recording.bag)) as bag:
            clouds = {cloud.header.stamp.to_nsec(): self._points(cloud, focal_px)
                      for _, cloud, _ in bag.read_messages(topics=[recording.image_topic])}
        stamps_ns = sorted(clouds)
        if len(stamps_ns) <= self.APART:
            raise RuntimeError("%s: %d images with tracks" % (name, len(stamps_ns)))
        truth = recording.truth.at(np.array(stamps_ns) * 1e-9 + recording.shift_s)
        R_world_imu = rotations(truth.q)
        R_world_cam = R_world_imu @ np.array(recording.camera["R_cam_imu"]).T
        p_cam_m = truth.p_m + R_world_imu @ np.array(recording.camera["p_imu_cam_m"])
        errors_deg, counts = [], []
        for k in range(len(stamps_ns) - self.APART):
            way_m = p_cam_m[k + self.APART] - p_cam_m[k]
            if np.linalg.norm(way_m) < self.MIN_WAY_M:
                continue
            pair = clouds[stamps_ns[k]], clouds[stamps_ns[k + self.APART]]
            ids = sorted(pair[0].keys() & pair[1].keys())
            counts.append(len(ids))
            R_true = R_world_cam[k + self.APART].T @ R_world_cam[k]
            t_true = -R_world_cam[k + self.APART].T @ way_m
            errors_deg.append(self._errors_deg(pair, ids, R_true, t_true / np.linalg.norm(t_true), focal_px))
        if not errors_deg:
            raise RuntimeError("%s: the camera hardly moves" % name)
        medians = np.median(errors_deg, axis=0)
        return dict(zip(list(self.metrics)[:4], map(float, medians)), tracks=float(np.mean(counts)))

    def _errors_deg(self, pair, ids, R_true, t_true, focal_px):
        """In the order of the metrics."""
        lost = [self.LOST_DEG] * 4
        if len(ids) < self.MIN_TRACKS:
            return lost
        (first, first_covariances), (second, second_covariances) = (
            map(np.array, zip(*(points[i] for i in ids))) for points in pair)
        start = relative_motion(first, second, focal_px)
        if start is None:
            return lost
        equal = np.broadcast_to(np.eye(2) / focal_px**2, first_covariances.shape)
        errors_deg = []
        for covariances in (equal, equal), (first_covariances, second_covariances):
            R, t = refined_motion(*start, first, second, *covariances)
            errors_deg.append((float(np.degrees(np.arccos(np.clip(t @ t_true, -1, 1)))), angle_deg(R @ R_true.T)))
        return [errors_deg[0][0], errors_deg[1][0], errors_deg[0][1], errors_deg[1][1]]


def relative_motion(first, second, focal_px):
    """Of the camera between two images, from normalised points: rotation first to second, unit translation; None when
    they determine none."""
    E, inliers = cv2.findEssentialMat(first, second, np.eye(3), cv2.RANSAC, 0.999, 1.5 / focal_px)
    if E is None or E.shape != (3, 3):
        return None
    _, R, t, _ = cv2.recoverPose(E, first, second, np.eye(3), mask=inliers)
    return R, t[:, 0]


def refined_motion(R, t, first, second, first_covariances, second_covariances):
    """The motion that makes least the sum of squared distances from the epipolar lines, each over its standard
    deviation (Hartley and Zisserman, Multiple View Geometry, 11.4.3), with Huber's weights. Only ratios of
    covariances count. A point of unknown place has an infinite variance and counts for nothing."""
    x1, x2 = (np.column_stack([points, np.ones(len(points))]) for points in (first, second))
    known = np.isfinite(first_covariances[:, 0, 0]) & np.isfinite(second_covariances[:, 0, 0])
    if known.sum() < 8:
        return R, t
    x1, x2, c1, c2 = x1[known], x2[known], first_covariances[known], second_covariances[known]

    def distances(R, t):
        E = cross_matrix(t) @ R
        lines_2, lines_1 = x1 @ E.T, x2 @ E
        variance = (np.einsum("ni,nij,nj->n", lines_2[:, :2], c2, lines_2[:, :2]) +
                    np.einsum("ni,nij,nj->n", lines_1[:, :2], c1, lines_1[:, :2]))
        return (x2 * lines_2).sum(1) / np.sqrt(variance)

    def moved(R, t, step):
        across = np.linalg.svd(t[None])[2][1:]
        t = t + step[3:] @ across
        return cv2.Rodrigues(step[:3])[0] @ R, t / np.linalg.norm(t)

    def robust_sum(d, scale):
        d = np.abs(d) / scale
        return np.where(d < HUBER, 0.5 * d * d, HUBER * (d - 0.5 * HUBER)).sum()

    step_size, damping = 1e-6, 1e-3
    current = distances(R, t)
    scale = np.median(np.abs(current)) / 0.6745 + 1e-12  # of a normal distribution
    for _ in range(15):
        jacobian = np.stack([(distances(*moved(R, t, step_size * unit)) - current) / step_size
                             for unit in np.eye(5)], 1)
        weights = np.minimum(1, HUBER * scale / np.maximum(np.abs(current), 1e-12))
        normal = jacobian.T @ (weights[:, None] * jacobian)
        step = -np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), jacobian.T @ (weights * current),
                                rcond=None)[0]
        trial = moved(R, t, step)
        changed = distances(*trial)
        if robust_sum(changed, scale) < robust_sum(current, scale):
            (R, t), current, damping = trial, changed, damping / 3
            if np.linalg.norm(step) < 1e-7:
                break
        else:
            damping *= 10
    return R, t


HUBER = 1.345  # 95 % efficient where errors are normal


def cross_matrix(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
