"""COLMAP: its database (https://colmap.github.io/database.html) with features and matches from here, its commands."""

import concurrent.futures
import contextlib
import shutil
import sqlite3
import subprocess

import numpy
from tqdm import tqdm

from common import ONE_THREAD, fail

PINHOLE = 1
PAIR_BASE = 2147483647  # the id of a pair is this times the first image's, plus the second image's
PIXEL_CENTER = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), OpenCV's at (0, 0)

SUCCESSORS = (1, 2, 4, 8, 16)  # frames that each frame is matched with
# Every fourth frame is matched with these, too: only they see the wall from places far enough apart to begin with.
FAR_SUCCESSORS, FAR_PERIOD = (32, 64), 4
PAIRS_AT_A_TIME = 40  # for the progress to move
MAX_RATIO, MAX_ANGLE = 0.8, 0.7  # COLMAP's defaults (SiftMatching.max_ratio, max_distance [rad])
DESCRIPTOR_LENGTH = 512  # of a SIFT descriptor as bytes
MIN_START_ANGLE_DEG = 3  # between the rays of the first two frames; COLMAP wants 16, which neighbours in a video lack
# The same for all variants. The whole model is adjusted after it has grown by 40 % instead of 10 %, as COLMAP's
# automatic reconstruction does with videos. Adjustments end when the cost changes by less than a millionth (Ceres
# Solver's default); COLMAP has no such limit and goes on to its number of iterations, which takes most of the time.
MAPPER = {"Mapper__ba_global_images_ratio": 1.4, "Mapper__ba_global_points_ratio": 1.4,
          "Mapper__ba_global_function_tolerance": 1e-6, "Mapper__ba_local_function_tolerance": 1e-6,
          "Mapper__ba_refine_focal_length": 0, "Mapper__ba_refine_extra_params": 0, "Mapper__extract_colors": 0,
          "Mapper__init_min_tri_angle": MIN_START_ANGLE_DEG}


@contextlib.contextmanager
def opened(path):
    """A database that is written and closed in the end, so that its file is complete."""
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        yield database


def remove_database(path):
    """With the journals of a database whose writer was killed, which SQLite would write into the next of that name."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def copy_database(source, path):
    remove_database(path)
    shutil.copy(source, path)


def load_features(prefix, rectified):
    """Keypoints (n, 4): x, y, scale, orientation in COLMAP's convention, float32; and descriptors (n, 128), uint8."""
    raw = numpy.load(f"{prefix}_keypoints.npy")
    position = raw[:, 4:6] if rectified else raw[:, 0:2]
    # OpenCV's size is a diameter, two sigma.
    keypoints = numpy.column_stack([position + PIXEL_CENTER, raw[:, 2] / 2, numpy.radians(raw[:, 3])])
    return keypoints.astype(numpy.float32), numpy.load(f"{prefix}_descriptors.npy")


def create_database(path, camera, names):
    """An empty database with one camera of known intrinsics and images `names`, numbered from 1."""
    subprocess.run(["colmap", "database_creator", "--database_path", str(path)], check=True, stdout=subprocess.DEVNULL)
    parameters = numpy.array([camera["fx_px"], camera["fy_px"], camera["cx_px"] + PIXEL_CENTER,
                              camera["cy_px"] + PIXEL_CENTER], numpy.float64)
    with opened(path) as database:
        database.execute("INSERT INTO cameras VALUES (1, ?, ?, ?, ?, 1)",
                         (PINHOLE, int(camera["width_px"]), int(camera["height_px"]), parameters.tobytes()))
        for i, name in enumerate(names, 1):
            database.execute("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, 1)", (i, name))


def set_keypoints(path, features):
    """Replaces the keypoints of all images; what was verified with the old ones is dropped, matches stay."""
    with opened(path) as database:
        database.execute("DELETE FROM keypoints")
        database.execute("DELETE FROM two_view_geometries")
        for i, (keypoints, _) in enumerate(features, 1):
            database.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", (i, *keypoints.shape, keypoints.tobytes()))


def set_descriptors(path, features):
    with opened(path) as database:
        database.execute("DELETE FROM descriptors")
        for i, (_, descriptors) in enumerate(features, 1):
            database.execute("INSERT INTO descriptors VALUES (?, ?, ?, ?)",
                             (i, *descriptors.shape, descriptors.tobytes()))


def run(command, log, progress=None, **options):
    """Runs COLMAP; returns whether it succeeded. Raises SystemExit when a signal ended it, which says nothing of its
    input. Its output goes to the file `log`; `progress` counts the images that it registers."""
    arguments = [part for key, value in options.items() for part in ("--" + key.replace("__", "."), str(value))]
    with open(log, "a") as output, subprocess.Popen(["colmap", command, *arguments], stdout=subprocess.PIPE, text=True,
                                                    stderr=subprocess.STDOUT, env=ONE_THREAD) as process:
        for line in process.stdout:
            output.write(line)
            if progress is not None and line.startswith("Registering image"):
                progress.update()
    if process.returncode < 0:
        fail(f"signal {-process.returncode} ended colmap {command}; see {log}")
    return process.returncode == 0


def require(success, command, log):
    if not success:
        fail(f"colmap {command} failed; see {log}")


def match_descriptors(a, b):
    """Pairs (n, 2), uint32, of descriptors (rows of `a` and `b`, uint8): each the other's nearest, nearer than
    MAX_ANGLE and than MAX_RATIO times the second nearest on either side. These are COLMAP's rules; its version without
    CUDA searches approximately and for longer. A matrix product of floats is exact: sums are whole numbers below 2^24.
    It is fast with OpenBLAS, and slow with the reference BLAS."""
    if not len(a) or not len(b):
        return numpy.empty((0, 2), numpy.uint32)
    product = a.astype(numpy.float32) @ b.astype(numpy.float32).T

    def angle(values):
        return numpy.arccos(numpy.minimum(values / DESCRIPTOR_LENGTH ** 2, 1))

    rows = numpy.arange(len(a))
    nearest = product.argmax(axis=1)
    best = product[rows, nearest]
    mutual = best == product.max(axis=0)[nearest]
    # Of rows that are equally near to a column none matches; columns that are equally near to a row fail the ratio.
    mutual &= numpy.bincount(nearest[mutual], minlength=len(b))[nearest] == 1
    product[rows, nearest] = 0
    second_of_row = product.max(axis=1)
    product[rows[~mutual], nearest[~mutual]] = best[~mutual]  # these are in the way of nobody but other rows
    second_of_column = product.max(axis=0)[nearest]
    limit = numpy.minimum(MAX_ANGLE, MAX_RATIO * numpy.minimum(angle(second_of_row), angle(second_of_column)))
    kept = mutual & (angle(best) < limit)
    return numpy.column_stack([rows[kept], nearest[kept]]).astype(numpy.uint32)


def pairs_to_match(count):
    """Pairs of frames, by number from 0."""
    return [(i, i + step) for i in range(count) for step in SUCCESSORS + (FAR_SUCCESSORS if i % FAR_PERIOD == 0 else ())
            if i + step < count]


def match(path, features, label, workers):
    """Matches the descriptors of each frame with those of its successors and writes the matches into the database;
    `workers` pairs at a time."""
    pairs = pairs_to_match(len(features))

    def matched(pair):
        return match_descriptors(features[pair[0]][1], features[pair[1]][1])

    # The matrix product and the searches run outside Python's lock.
    with opened(path) as database, concurrent.futures.ThreadPoolExecutor(workers) as pool:
        for (i, j), matches in tqdm(zip(pairs, pool.map(matched, pairs)), desc=f"  matching, {label}", unit="pair",
                                    total=len(pairs), mininterval=1):
            database.execute("INSERT INTO matches VALUES (?, ?, 2, ?)",
                             (PAIR_BASE * (i + 1) + j + 1, len(matches), matches.tobytes()))


def verify(database, names, log, seed, progress):
    """COLMAP's verification of the matches that are in the database, by the geometry of two views."""
    pairs = [f"{names[i]} {names[j]}\n" for i, j in pairs_to_match(len(names))]
    path = database.with_suffix(".pairs")
    for start in range(0, len(pairs), PAIRS_AT_A_TIME):
        chunk = pairs[start:start + PAIRS_AT_A_TIME]
        path.write_text("".join(chunk))
        require(run("matches_importer", log, database_path=database, match_list_path=path, match_type="pairs",
                    random_seed=seed, SiftMatching__use_gpu=0, SiftMatching__num_threads=1), "matches_importer", log)
        progress.update(len(chunk))


def reconstruct(database, folder, log, seed, progress):
    """COLMAP's models, as text in sibling folders of `folder`; none where it finds no pair to begin with."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if not run("mapper", log, progress, database_path=database, image_path=folder, output_path=folder,
               random_seed=seed, Mapper__num_threads=1, **MAPPER):
        return
    for model in sorted(p for p in folder.iterdir() if p.name.isdigit()):
        text = folder / f"{model.name}_text"
        text.mkdir()
        require(run("model_converter", log, input_path=model, output_path=text, output_type="TXT"),
                "model_converter", log)
