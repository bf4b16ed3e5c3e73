#!/usr/bin/env python3
"""The SLAM experiment: errors of trajectories against analytic truth; a stack's files; a short flight, evaluated by the
package's own tracks, from bag to table."""

import argparse
import dataclasses
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest
import unittest.mock

import numpy as np
import rosbag
import rospy
from std_msgs.msg import Header

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "experiments" / "slam"), str(ROOT / "experiments")]
from evaluators import Lost, OpenVins, OpenVinsTracks, Recording, refined_motion, relative_motion  # noqa: E402
from slam import deblurred_recording  # noqa: E402
from trajectory import (Trajectory, absolute_error_m, aligned, angle_deg, common, relative_errors,  # noqa: E402
                        rotations)

SLAM = ["/usr/bin/python3", ROOT / "experiments" / "slam" / "slam.py"]
SKIPPED = 77  # ctest's SKIP_RETURN_CODE
arguments = None


def yaw(angle_rad):
    return np.array([0, 0, np.sin(angle_rad / 2), np.cos(angle_rad / 2)])


def circle(seconds=20.0, rate_hz=50):
    """A body that looks along its way around a circle of 2 m, 0.5 rad/s."""
    t_s = np.arange(0, seconds, 1 / rate_hz)
    angle = 0.5 * t_s
    p_m = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0.1 * np.sin(2 * angle)], 1)
    return Trajectory(t_s, p_m, np.array([yaw(a) for a in angle]))


def recording(bag, topic):
    """Of that circle."""
    return Recording(bag, topic, "/imu", 0.015, False,
                     {"intrinsics": [460, 461, 375.5, 239.5], "size": [752, 480],
                      "R_cam_imu": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "p_imu_cam_m": [-0.05, -0.04, 0]},
                     {"rate_hz": 200, "gyro_noise_rad_s": 0.003, "accel_noise_m_s2": 0.05}, circle(), np.zeros(6))


class Trajectories(unittest.TestCase):
    def test_rotations_take_the_body_to_the_world(self):
        R = rotations([yaw(np.pi / 2), [np.sin(0.15), 0, 0, np.cos(0.15)]])
        np.testing.assert_allclose(R[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(R[1] @ [0, 1, 0], [0, np.cos(0.3), np.sin(0.3)], atol=1e-12)
        self.assertAlmostEqual(angle_deg(R[1]), np.degrees(0.3), 6)

    def test_between_poses(self):
        middle = circle().at([1.01])
        np.testing.assert_allclose(middle.p_m[0], circle(rate_hz=100).at([1.01]).p_m[0], atol=1e-3)
        self.assertAlmostEqual(np.linalg.norm(middle.q[0]), 1, 12)
        np.testing.assert_allclose(middle.q[0], yaw(0.505), atol=1e-5)

    def test_yaw_and_place_cost_nothing(self):
        truth = circle()
        R = rotations([yaw(1.1)])[0]
        moved = Trajectory(truth.t_s, truth.p_m @ R.T + [3, -2, 1], truth.q)
        self.assertLess(absolute_error_m(moved, truth), 1e-12)
        np.testing.assert_allclose(aligned(moved, truth), truth.p_m, atol=1e-12)

    def test_roll_and_scale_do(self):
        truth = circle()
        larger = Trajectory(truth.t_s, 1.1 * truth.p_m, truth.q)
        spread_m = np.sqrt(((truth.p_m - truth.p_m.mean(0)) ** 2).sum(1).mean())
        self.assertAlmostEqual(absolute_error_m(larger, truth), 0.1 * spread_m, 3)
        roll = rotations([[np.sin(0.05), 0, 0, np.cos(0.05)]])[0]
        self.assertGreater(absolute_error_m(Trajectory(truth.t_s, truth.p_m @ roll.T, truth.q), truth), 0.05)

    def test_relative_errors_of_a_wrong_scale(self):
        truth = circle()
        errors = relative_errors(Trajectory(truth.t_s, 1.02 * truth.p_m, truth.q), truth, 5.0)
        # 2 % of the chord, over the arc, which is a little longer by its rise and fall.
        chord_over_arc = 2 * 2 * np.sin(1.25) / (2 * 2.5)
        np.testing.assert_allclose(errors, 2 * chord_over_arc, rtol=0.02)
        self.assertEqual(len(errors), 30)

    def test_only_what_is_true_is_compared(self):
        truth = circle()
        early = Trajectory(np.array([-1.0, 0.5, 1.0]), np.zeros((3, 3)), np.array([yaw(0)] * 3))
        estimate, of_truth = common(early, truth)
        self.assertEqual(len(estimate.t_s), 2)
        np.testing.assert_allclose(of_truth.t_s, [0.5, 1.0])


class Motion(unittest.TestCase):
    def test_relative_motion_of_points_in_space(self):
        random = np.random.default_rng(1)
        points = np.column_stack([random.uniform(-2, 2, (60, 2)), random.uniform(3, 6, 60)])
        R = rotations([[np.sin(0.1), 0, 0, np.cos(0.1)]])[0]
        t = np.array([0.2, 0.05, -0.1])
        second = points @ R.T + t
        found_R, found_t = relative_motion(points[:, :2] / points[:, 2:], second[:, :2] / second[:, 2:], 460)
        self.assertLess(angle_deg(found_R @ R.T), 1e-3)
        np.testing.assert_allclose(found_t, t / np.linalg.norm(t), atol=1e-4)
        equal = np.broadcast_to(np.eye(2), (60, 2, 2))
        off = rotations([[0, np.sin(0.01), 0, np.cos(0.01)]])[0]
        found_R, found_t = refined_motion(off @ R, off @ found_t, points[:, :2] / points[:, 2:],
                                          second[:, :2] / second[:, 2:], equal, equal)
        self.assertLess(angle_deg(found_R @ R.T), 1e-3)
        np.testing.assert_allclose(found_t, t / np.linalg.norm(t), atol=1e-4)

    def test_weights_by_covariances_pay(self):
        """Points that are uncertain along lines of their own, as far as is said."""
        random = np.random.default_rng(2)
        errors_deg = {"equal": [], "weighed": []}
        for _ in range(40):
            points = np.column_stack([random.uniform(-2, 2, (80, 2)), random.uniform(3, 6, 80)])
            R, t = rotations([[0, np.sin(0.05), 0, np.cos(0.05)]])[0], np.array([0.9, 0.3, -0.3])
            angles, deviations = random.uniform(0, np.pi, 80), random.choice([0.2, 3.0], 80) / 460
            along = np.column_stack([np.cos(angles), np.sin(angles)])
            covariances = (deviations**2)[:, None, None] * along[:, :, None] * along[:, None, :] + \
                (0.2 / 460)**2 * np.eye(2)
            noise = [np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), random.normal(size=(80, 2)))
                     for _ in range(2)]
            second = points @ R.T + 0.3 * t
            first, second = (p[:, :2] / p[:, 2:] + n for p, n in zip((points, second), noise))
            equal = np.broadcast_to(np.eye(2), covariances.shape)
            for name, c in ("equal", equal), ("weighed", covariances):
                _, found = refined_motion(R, t / np.linalg.norm(t), first, second, c, c)
                errors_deg[name].append(np.degrees(np.arccos(np.clip(found @ t / np.linalg.norm(t), -1, 1))))
        self.assertLess(np.median(errors_deg["weighed"]), 0.6 * np.median(errors_deg["equal"]))


class OpenVinsFiles(unittest.TestCase):
    def test_settings_are_read_by_opencv(self):
        import cv2
        with tempfile.TemporaryDirectory() as folder:
            path = OpenVins.write_settings(recording(pathlib.Path("a.bag"), "/camera/image_raw"), pathlib.Path(folder),
                                           {"num_pts": 150})
            settings = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
            self.assertEqual(settings.getNode("num_pts").real(), 150)
            cameras = cv2.FileStorage(str(path.parent / settings.getNode("relative_config_imucam").string()),
                                      cv2.FILE_STORAGE_READ)
            chain = cameras.getNode("cam0")
            self.assertAlmostEqual(chain.getNode("timeshift_cam_imu").real(), 0.015)
            rows = chain.getNode("T_imu_cam")
            matrix = [[rows.at(r).at(c).real() for c in range(4)] for r in range(4)]
            np.testing.assert_allclose(matrix, [[0, -1, 0, -0.05], [1, 0, 0, -0.04], [0, 0, 1, 0], [0, 0, 0, 1]])
            inertial = cv2.FileStorage(str(path.parent / settings.getNode("relative_config_imu").string()),
                                       cv2.FILE_STORAGE_READ)
            imu = inertial.getNode("imu0")
            self.assertAlmostEqual(imu.getNode("gyroscope_noise_density").real(), 0.003 / np.sqrt(200))

    def test_states_are_poses_of_the_body(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "states.txt"
            path.write_text("# timestamp(s) q p v ...\n" + 2 * "5.0 0.1 0.2 0.3 0.9 1 2 3 4 5 6 7 8 9 10 11 12\n")
            states = OpenVins.read_states(path)
            np.testing.assert_allclose(states.p_m, 2 * [[1, 2, 3]])
            np.testing.assert_allclose(states.q, 2 * [[0.1, 0.2, 0.3, 0.9]])

    def test_states_that_end_early_are_lost(self):
        truth = circle()
        almost = truth.at(truth.t_s[truth.t_s < 17])
        self.assertLess(OpenVins.errors(almost, truth)["ate_m"], 1e-9)
        with self.assertRaisesRegex(Lost, "75 %"):
            OpenVins.errors(truth.at(truth.t_s[truth.t_s < 15.01]), truth)
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "states.txt"
            path.write_text("# timestamp(s) q p v ...\n")
            with self.assertRaisesRegex(Lost, "no states"):
                OpenVins.read_states(path)


# Gives the states in the file next to it, and ends as when the library ends the process; refuses where there is none.
SUBSTITUTE = """#!/usr/bin/python3
import pathlib, shutil, sys
given = dict(part.split(":=") for part in sys.argv[1:])
shutil.copy(given["_config_path"], pathlib.Path(__file__).parent / "settings.txt")
assert (given["imu"], given["feature_tracks"]) == ("/imu", "/tracks")
assert pathlib.Path(given["_path_gt"]).read_text().startswith("#t")
source = pathlib.Path(__file__).parent / "given.txt"
if not source.exists():
    sys.exit("the substitute refuses")
shutil.copy(source, given["_filepath_est"])
sys.exit(1)
"""


class OpenVinsOnTracks(unittest.TestCase):
    """Its evaluator, with a substitute for the program that reads tracks."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.truth = circle()
        with rosbag.Bag(str(self.folder / "tracks.bag"), "w") as bag:
            bag.write("/tracks", Header(), rospy.Time.from_sec(1.0))
        program = self.folder / "program"
        program.write_text(SUBSTITUTE)
        program.chmod(0o755)
        (self.folder / "lib" / "ov_msckf").mkdir(parents=True)
        (self.folder / "lib" / "ov_msckf" / "ros1_serial_msckf").touch()
        for name, substitute in ("program", lambda *_: program), ("environment", lambda *_: None):
            patch = unittest.mock.patch.object(OpenVinsTracks, name, substitute)
            self.addCleanup(patch.stop)
            patch.start()

    def metrics(self, evaluator=OpenVinsTracks):
        with unittest.mock.patch("evaluators.Master"):
            made = evaluator(self.folder, self.folder)
        return made.evaluate(recording(self.folder / "tracks.bag", "/tracks"), self.folder, "run")

    def write_states(self, scale):
        rows = ["%.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f" % (t_s, *q, *(scale * p_m)) for t_s, p_m, q in
                zip(self.truth.t_s, self.truth.p_m, self.truth.q)]
        (self.folder / "given.txt").write_text("# t q p\n" + "\n".join(rows) + "\n")

    def test_its_states_are_compared_with_the_truth(self):
        self.write_states(1.1)
        metrics = self.metrics()
        self.assertEqual(set(metrics), set(OpenVinsTracks.metrics))
        larger = Trajectory(self.truth.t_s, 1.1 * self.truth.p_m, self.truth.q)
        self.assertAlmostEqual(metrics["ate_m"], absolute_error_m(larger, self.truth), 6)

    def test_another_deviation_has_another_name(self):
        self.write_states(1.0)
        wide = OpenVinsTracks.with_sigma(0.7)
        for evaluator, sigma in (OpenVinsTracks, "0.5"), (wide, "0.7"):
            self.metrics(evaluator)
            settings = (self.folder / "settings.txt").read_text()
            for key in "up_msckf_sigma_px", "up_slam_sigma_px":
                self.assertIn("%s: %s\n" % (key, sigma), settings)
        self.assertEqual(wide.name, OpenVinsTracks.name + ", 0.7 px")

    def test_what_deblur_bag_writes(self):
        """Rows of one instant are stamped with it."""
        given = recording(pathlib.Path("raw.bag"), "/camera/image_raw")
        for rolling, tracks, topic in ((False, False, "/camera/deblurred/image_raw"),
                                       (False, True, "/camera/feature_tracks"),
                                       (True, False, "/camera/global_shutter/image_raw"),
                                       (True, True, "/camera/global_shutter/feature_tracks")):
            made = deblurred_recording(dataclasses.replace(given, rolling=rolling), tracks, pathlib.Path("out.bag"))
            self.assertEqual((made.image_topic, made.bag.name), (topic, "out.bag"))
            self.assertEqual(made.shift_s, 0 if rolling else given.shift_s)

    def test_a_refusal_is_no_result(self):
        with self.assertRaisesRegex(RuntimeError, "the substitute refuses"):
            self.metrics()


class Report(unittest.TestCase):
    def test_two_evaluators_side_by_side(self):
        errors_m = {"sharp": 0.01, "blurred": 0.05, "gyroscope": 0.04, "package": 0.02}
        results = []
        for case in "V1_02_medium_30ms_x1.7_r0", "V1_02_medium_30ms_x1.7_r20":
            for seed, off_m in (1, -0.001), (2, 0), (3, 0.001):
                for variant, error_m in errors_m.items():
                    key = {"case": case, "seconds": 20, "light": "day", "seed": seed, "variant": variant}
                    if variant == "blurred" and case.endswith("r20"):
                        error_m *= 2
                    ate_m = error_m + off_m
                    lost = variant == "gyroscope" and case.endswith("r20") and seed == 2
                    results.append({**key, "evaluator": OpenVins.name, "ate_m": None if lost else ate_m,
                                    "rte_percent": 10 * ate_m})
                    if variant in OpenVinsTracks.variants:
                        results.append({**key, "evaluator": OpenVinsTracks.name, "ate_m": ate_m / 2, "rte_percent": 1})
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder)
            (out / "results.json").write_text(json.dumps(results))
            command = [*SLAM, "--report", "--out", out, "--data", arguments.data, "--only", "V1_02_medium_30ms_x1.7",
                       "--lights", "day", "--variants", "sharp", "blurred", "gyroscope", "package"]
            subprocess.run(command + ["--openvins", out, "--tracks"], check=True, stdout=subprocess.DEVNULL)
            lines = (out / "slam.md").read_text().splitlines()
            self.assertIn("| flight | conditions | sharp | blurred | gyroscope alone | the package | tracks | "
                          "tracks, sharp images | of the way to sharp |", lines)
            self.assertIn("| drone (EuRoC V1_02) | 30 ms, x1.7 | 0.010 ± 0.001 | 0.050 ± 0.001 | 0.040 ± 0.001 | "
                          "0.020 ± 0.001 | 0.010 ± 0.000 | 0.005 ± 0.000 | 25 %, 75 % |", lines)
            self.assertIn("| drone (EuRoC V1_02) | 30 ms, readout 20 ms, x1.7 | 0.010 ± 0.001 | 0.100 ± 0.001 | "
                          "lost | 0.020 ± 0.001 | 0.010 ± 0.000 | 0.005 ± 0.000 | -, 89 % |", lines)
            ratios = [line for line in lines if line.startswith("Over sharp: ")]
            # 5 and 10; the standard error is half of the difference of their logarithms.
            self.assertIn("blurred 7.07 ± 2.45", ratios[0])
            self.assertIn("the package 2.00 ± 0.00, tracks 1.00 ± 0.00, tracks, sharp images 0.50 ± 0.00", ratios[0])
            self.assertNotIn("gyroscope", ratios[0])  # one of its cells is lost
            self.assertGreater((out / "slam.png").stat().st_size, 1000)
            refused = subprocess.run(command + ["--tracks"], check=False, stderr=subprocess.PIPE)
            self.assertEqual(refused.returncode, 1)
            self.assertIn(b"--tracks needs --openvins", refused.stderr)


class ShortFlight(unittest.TestCase):
    def test_own_tracks_evaluate(self):
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder)
            command = [*SLAM, "--out", out, "--data", arguments.data, "--programs", arguments.programs, "--only",
                       "V1_02_medium_30ms_x1.7_r0", "--seconds", "3", "--seeds", "1", "--lights", "day"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            results = {r["variant"]: r for r in json.loads((out / "results.json").read_text())}
            self.assertEqual(set(results), {"sharp", "blurred", "package"})
            self.assertGreater(results["package"]["tracks"], 1.15 * results["blurred"]["tracks"])
            self.assertGreater(results["sharp"]["tracks"], results["package"]["tracks"])
            self.assertLess(results["sharp"]["direction_deg"], results["blurred"]["direction_deg"])
            self.assertIn("| drone (EuRoC V1_02) | 30 ms, x1.7 |", (out / "slam.md").read_text())
            self.assertGreater((out / "slam.png").stat().st_size, 1000)
            # What is there is not measured again.
            before = (out / "results.json").read_bytes()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            self.assertEqual((out / "results.json").read_bytes(), before)
            # With less given there are fewer long tracks, but more than half.
            lacking = "exposure-x1.6", "camera-info-only", "no-imu"
            subprocess.run([*command, "--variants", *lacking], check=True, stdout=subprocess.DEVNULL)
            results.update((r["variant"], r) for r in json.loads((out / "results.json").read_text()))
            for variant in lacking:
                self.assertGreater(results[variant]["tracks"], 0.5 * results["package"]["tracks"])
                self.assertLess(results[variant]["tracks"], 0.95 * results["package"]["tracks"])
            refused = subprocess.run([*command, "--variants", "sharp", "no-gyro"], check=False, stderr=subprocess.PIPE)
            self.assertEqual(refused.returncode, 1)
            self.assertIn(b"no-gyro is neither one of sharp, blurred", refused.stderr)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("data", type=pathlib.Path)
    arguments = parser.parse_args()
    if not (arguments.data / "trajectories").exists():
        print(f"SKIPPED:\nthere is no {arguments.data}/trajectories")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
