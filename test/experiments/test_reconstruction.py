#!/usr/bin/env python3
"""The importer and the measurements of experiments/reconstruction.py against known features, poses and planes."""

import concurrent.futures
import contextlib
import os
import pathlib
import shutil
import sqlite3
import sys
import tempfile
import threading
import unittest
from unittest import mock

import numpy
from tqdm import tqdm

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "experiments"))
import colmap  # noqa: E402
import colmap_models  # noqa: E402
import reconstruction  # noqa: E402
from reconstruction_sequence import VARIANTS  # noqa: E402

COUNT = 60


def rotation(axis, degrees):
    half = numpy.radians(degrees) / 2
    return colmap_models.rotation_matrix(numpy.append(numpy.cos(half), numpy.sin(half) * numpy.array(axis)))


class Measurements(unittest.TestCase):
    def setUp(self):
        self.rng = numpy.random.default_rng(3)

    def test_similarity_comes_back_in_spite_of_wrong_cameras(self):
        source = self.rng.uniform(-1, 1, (40, 3))
        R, scale, t = rotation([0.6, 0, 0.8], 50), 2.5, numpy.array([1.0, -2, 3])
        target = scale * source @ R.T + t
        target[::9] += 0.5
        found_scale, found_R, found_t = colmap_models.robust_similarity(source, target, self.rng)
        self.assertAlmostEqual(found_scale, scale, 6)
        numpy.testing.assert_allclose(found_R, R, atol=1e-6)
        numpy.testing.assert_allclose(found_t, t, atol=1e-6)

    def test_plane_comes_back_in_spite_of_wrong_points(self):
        R = rotation([1, 0, 0], 20)
        points = numpy.column_stack([self.rng.uniform(-1, 1, (200, 2)), self.rng.normal(0, 0.002, 200)]) @ R.T + R[:, 2] * 2
        points[::5] += self.rng.uniform(-1, 1, (40, 3))
        normal, offset = colmap_models.fit_plane(points, self.rng)
        sign = numpy.sign(normal @ R[:, 2])
        numpy.testing.assert_allclose(sign * normal, R[:, 2], atol=5e-3)
        self.assertAlmostEqual(sign * offset, 2, 2)

    def test_descriptors_match_as_pair_by_pair(self):
        a = self.rng.integers(0, 60, (150, 128)).astype(float)
        b = numpy.vstack([a[20:110] + self.rng.normal(0, 12, (90, 128)), self.rng.integers(0, 60, (30, 128)),
                          a[20:40] + self.rng.normal(0, 13, (20, 128))])  # the last ones make the first ambiguous
        a, b = (512 * d / numpy.linalg.norm(d, axis=1, keepdims=True) for d in (a, b))
        a, b = (d.clip(0, 255).astype(numpy.uint8) for d in (a, b))
        angles = numpy.array([[numpy.arccos(min(1, float(x @ y) / 512 ** 2)) for y in b.astype(float)]
                              for x in a.astype(float)])

        def nearest(rows):
            order = numpy.argsort(rows, axis=1)[:, :2]
            first, second = numpy.take_along_axis(rows, order, 1).T
            return {i: order[i, 0] for i in range(len(rows)) if first[i] < min(0.7, 0.8 * second[i])}

        forth, back = nearest(angles), nearest(angles.T)
        expected = [(i, j) for i, j in sorted(forth.items()) if back.get(j) == i]
        self.assertGreater(len(expected), 30)
        self.assertLess(len(expected), 90)
        numpy.testing.assert_array_equal(colmap.match_descriptors(a, b), expected)

    def test_of_descriptors_that_are_equally_near_none_matches(self):
        a = self.rng.integers(0, 60, (6, 128)).astype(float)
        b = a + self.rng.normal(0, 5, a.shape)
        a, b = (512 * d / numpy.linalg.norm(d, axis=1, keepdims=True) for d in (a, b))
        a, b = (d.clip(0, 255).astype(numpy.uint8) for d in (a, b))
        self.assertEqual(colmap.match_descriptors(a, b).tolist(), [[i, i] for i in range(6)])
        others = [[i, i] for i in (0, 1, 3, 4, 5)]
        # Number 2 is there two or three times on either side, then twice on both.
        for times in (1, 2):
            more = numpy.vstack([b, *[b[2:3]] * times])
            self.assertEqual(colmap.match_descriptors(a, more).tolist(), others)
            self.assertEqual(colmap.match_descriptors(more, a).tolist(), others)
        a, b = numpy.vstack([a, a[2:3]]), numpy.vstack([b, b[2:3]])
        self.assertEqual(colmap.match_descriptors(a, b).tolist(), others)
        # Without noise between the sides.
        self.assertEqual(colmap.match_descriptors(a, a[:6]).tolist(), others)
        self.assertEqual(colmap.match_descriptors(a[:6], a).tolist(), others)

    def test_a_perfect_model_has_no_errors_in_any_scale(self):
        # Two cameras over a plane, as COLMAP would have them: another origin, rotation and scale.
        camera = {"fx_px": 500, "fy_px": 500, "cx_px": 319.5, "cy_px": 239.5}
        world = numpy.column_stack([self.rng.uniform(-1, 1, (COUNT, 2)), numpy.full(COUNT, 2.0)])
        scale, R, t = 0.3, rotation([0, 1, 0], 35), numpy.array([5.0, 1, -2])
        truth, poses = {}, {}
        for k, x in enumerate((-0.4, -0.1, 0.1, 0.3, 0.5)):
            R_world_cam, position = rotation([0, 1, 0], 8 * k), numpy.array([x, 0.1 * x * x, 0])
            local = (world - position) @ R_world_cam
            pixels = local[:, :2] / local[:, 2:] * 500 + [319.5 + 0.5, 239.5 + 0.5]
            name = f"frame_{k:04d}"
            truth[name] = {"position": position, "R_world_cam": R_world_cam, "t_s": k, "extent_px": 0}
            # camera = R_cam_world (world - position), and model = scale R world + t
            pose = colmap_models.Pose(numpy.array([1.0, 0, 0, 0]), numpy.zeros(3), pixels, numpy.arange(COUNT))
            pose.R = R_world_cam.T @ R.T
            pose.center = scale * R @ position + t
            pose.t = -pose.R @ pose.center
            poses[name] = pose
        points = {i: (scale * R @ p + t, 5) for i, p in enumerate(world)}
        points[COUNT] = (numpy.array([9.0, 9, 9]), 2)  # seen in two images only: does not count
        frames, totals = colmap_models.measure((poses, points), truth, camera, self.rng)
        self.assertEqual((totals["registered"], totals["points"], totals["observations"]), (5, COUNT, 5 * COUNT))
        for key in ("reprojection_px", "plane_rmse_m", "position_rmse_m"):
            self.assertLess(totals[key], 1e-9, key)
        self.assertLess(max(row["rotation_error_deg"] for row in frames.values()), 1e-4)


class Run(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = pathlib.Path(folder.name)

    def colmap_that(self, script):
        """A shell script in COLMAP's place."""
        program = self.path / "colmap"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        change = mock.patch.dict(colmap.ONE_THREAD, PATH=f"{self.path}:{os.environ['PATH']}")
        change.start()
        self.addCleanup(change.stop)

    def test_no_model_is_a_result_and_a_signal_is_none(self):
        mark, log = self.path / "model.done", self.path / "log"

        def reconstruct():
            reconstruction.Stages(self.path).once("model", lambda: colmap.reconstruct(
                self.path / "a.db", self.path / "models", log, 1, tqdm(disable=True)))

        for name in ("TERM", "KILL"):
            self.colmap_that(f"kill -{name} $$")
            with self.assertRaisesRegex(SystemExit, "signal [0-9]+ ended colmap mapper"):
                reconstruct()
            self.assertFalse(mark.exists())
        self.colmap_that("exit 1")
        reconstruct()
        self.assertTrue(mark.exists())

    def test_where_a_variant_fails_those_that_wait_are_not_begun(self):
        begun, pool_ends = [], threading.Event()

        class Pool(concurrent.futures.ThreadPoolExecutor):
            def __exit__(self, *arguments):
                pool_ends.set()
                return super().__exit__(*arguments)

        def verify(database, *_):
            begun.append(database.stem)
            if database.stem == "blurred":
                raise KeyboardInterrupt
            self.assertTrue(pool_ends.wait(60))

        with mock.patch.object(reconstruction, "WORKERS", 1), \
                mock.patch.multiple(colmap, verify=verify, set_keypoints=mock.DEFAULT,
                                    reconstruct=lambda *_: begun.append("model")), \
                mock.patch("shutil.copy"), mock.patch("concurrent.futures.ThreadPoolExecutor", Pool), \
                self.assertRaises(KeyboardInterrupt):
            reconstruction.create_models(reconstruction.Stages(self.path), list(VARIANTS), self.path,
                                         [], 1)
        # The one worker may begin with the second before it is seen that the first failed.
        self.assertIn(begun, (["blurred"], ["blurred", "blurred_rectified"]))
        self.assertFalse((self.path / "verified_blurred.done").exists())

    def test_a_stage_is_done_once_and_again_where_it_failed(self):
        done = []

        def fails():
            done.append("fails")
            raise RuntimeError

        with tempfile.TemporaryDirectory() as folder:
            for _ in range(2):  # as an interrupted run and the one that goes on with it
                stages = reconstruction.Stages(pathlib.Path(folder))
                stages.once("first", lambda: done.append("first"))
                with self.assertRaises(RuntimeError):
                    stages.once("second", fails)
        self.assertEqual(done, ["first", "fails", "fails"])

    def test_pairs_lie_within_the_sequence(self):
        self.assertEqual(colmap.pairs_to_match(3), [(0, 1), (0, 2), (1, 2)])
        pairs = colmap.pairs_to_match(150)
        self.assertEqual(len(pairs), len(set(pairs)))
        self.assertIn((4, 68), pairs)
        self.assertNotIn((5, 69), pairs)
        self.assertTrue(all(0 <= i < j < 150 for i, j in pairs))

    def test_a_run_goes_on_with_its_own_options_only(self):
        options = {"seed": 1, "program": "sha256 a"}
        for _ in range(2):
            reconstruction.same_options(self.path, options)
        for name, value, said in (("seed", 2, "--seed was 1 and is 2"),
                                  ("program", "sha256 b", "--program was sha256 a and is sha256 b")):
            with self.assertRaisesRegex(SystemExit, said):
                reconstruction.same_options(self.path, dict(options, **{name: value}))
        reconstruction.same_options(self.path, options)
        (self.path / "features.done").touch()
        (self.path / "options.json").unlink()
        with self.assertRaisesRegex(SystemExit, "options.json is missing"):
            reconstruction.same_options(self.path, options)

    def test_a_copied_database_has_nothing_of_one_that_was_interrupted(self):
        source, path = self.path / "source.db", self.path / "copy.db"
        with colmap.opened(source) as database:
            database.execute("PRAGMA journal_mode=WAL")  # as COLMAP does
            database.execute("CREATE TABLE t (x)")
        shutil.copy(source, path)
        with contextlib.closing(sqlite3.connect(path)) as database:
            database.execute("INSERT INTO t VALUES (1)")
            database.commit()
            left = {suffix: (self.path / f"copy.db{suffix}").read_bytes() for suffix in ("-wal", "-shm")}
        for suffix, content in left.items():
            (self.path / f"copy.db{suffix}").write_bytes(content)
        colmap.copy_database(source, path)
        with contextlib.closing(sqlite3.connect(path)) as database:
            self.assertEqual(database.execute("SELECT * FROM t").fetchall(), [])


class Importer(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        rng = numpy.random.default_rng(5)
        raw = numpy.column_stack([rng.uniform(0, [640, 480], (COUNT, 2)), rng.uniform(2, 20, COUNT),
                                  rng.uniform(0, 360, COUNT), rng.uniform(0, [640, 480], (COUNT, 2))])
        descriptors = rng.exponential(1, (COUNT, 128))
        descriptors = descriptors / numpy.linalg.norm(descriptors, axis=1, keepdims=True) * 512  # OpenCV's length
        self.order = rng.permutation(COUNT)
        self.raw = raw.astype(numpy.float32)
        for name, order in (("a", numpy.arange(COUNT)), ("b", self.order)):
            numpy.save(self.path / f"{name}_keypoints.npy", self.raw[order])
            numpy.save(self.path / f"{name}_descriptors.npy", numpy.minimum(descriptors, 255).astype(numpy.uint8)[order])

    def tearDown(self):
        self.folder.cleanup()

    def test_colmap_has_and_matches_what_was_imported(self):
        camera = {"width_px": 640, "height_px": 480, "fx_px": 500, "fy_px": 501, "cx_px": 319.5, "cy_px": 239.5}
        database = self.path / "a.db"
        features = [colmap.load_features(self.path / name, False) for name in ("a", "b")]
        colmap.create_database(database, camera, ["a", "b"])
        colmap.set_descriptors(database, features)
        colmap.set_keypoints(database, features)
        colmap.match(database, features, "a and b", 1)
        colmap.verify(database, ["a", "b"], self.path / "log", 1, tqdm(disable=True))
        with sqlite3.connect(database) as connection:
            parameters, = connection.execute("SELECT params FROM cameras").fetchone()
            rows, columns, keypoints = connection.execute(
                "SELECT rows, cols, data FROM keypoints WHERE image_id = 1").fetchone()
            count, matches = connection.execute("SELECT rows, data FROM matches").fetchone()
            pairs = connection.execute("SELECT pair_id, rows FROM two_view_geometries").fetchall()
        numpy.testing.assert_array_equal(numpy.frombuffer(parameters), [500, 501, 320, 240])
        self.assertEqual((rows, columns), (COUNT, 4))
        keypoints = numpy.frombuffer(keypoints, numpy.float32).reshape(rows, columns)
        numpy.testing.assert_allclose(keypoints[:, :2], self.raw[:, :2] + 0.5)
        numpy.testing.assert_allclose(keypoints[:, 2:], self.raw[:, 2:4] * [0.5, numpy.pi / 180], rtol=1e-6)
        self.assertEqual(count, COUNT)
        matches = numpy.frombuffer(matches, numpy.uint32).reshape(count, 2)
        numpy.testing.assert_array_equal(self.order[matches[:, 1]], matches[:, 0])
        # The id is COLMAP's own way to name the pair, and the geometry of an image with itself fits every match.
        self.assertEqual(pairs, [(colmap.PAIR_BASE + 2, COUNT)])

    def test_rectified_coordinates_replace_the_raw_ones(self):
        keypoints, _ = colmap.load_features(self.path / "a", True)
        numpy.testing.assert_allclose(keypoints[:, :2], self.raw[:, 4:6] + 0.5)


if __name__ == "__main__":
    if "Importer" in sys.argv and shutil.which("colmap") is None:
        print("SKIPPED:\nthere is no COLMAP")
        sys.exit(reconstruction.SKIPPED)
    unittest.main()
