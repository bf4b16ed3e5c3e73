"""The simulated sequence of reconstruction.py: a camera along a wall of photographs, its features and its truth."""

import csv
import subprocess

import numpy
import yaml

import photo_wall
from colmap_models import rotation_matrix
from common import OPENCV_DOC, ROOT

WALL = ["aero1.jpg", "aloeL.jpg", "baboon.jpg", "board.jpg", "fruits.jpg",
        "starry_night.jpg", "building.jpg", "graf1.png", "butterfly.jpg", "home.jpg",
        "leuvenA.jpg", "messi5.jpg", "rubberwhale1.png", "box_in_scene.png", "squirrel_cls.jpg"]
COLUMNS = 5
TILE_M = (0.95, 0.76)
DISTANCE_M = 2.0

# name: (folder of the features, whether the keypoints are rectified, label)
VARIANTS = {
    "blurred": ("blurred", False, "SIFT on blurred frames"),
    "blurred_rectified": ("blurred", True, "SIFT on blurred frames, rectified"),
    "deblurred": ("deblurred", False, "ours, not rectified"),
    "deblurred_rectified": ("deblurred", True, "ours"),
}
BASELINE, OURS = "blurred", "deblurred_rectified"


def absent_photographs():
    return [name for name in WALL if not (OPENCV_DOC / name).is_file()]


def simulate(arguments, work):
    """Simulates the sequence and writes the features, images and truth."""
    scene = yaml.safe_load((ROOT / "experiments" / "scenes" / "reconstruction.yaml").read_text())
    texture = (work / "wall.png").resolve()
    photo_wall.compose([OPENCV_DOC / name for name in WALL], COLUMNS, texture, arguments.seed)
    scene.update(planes=[photo_wall.plane(texture, (COLUMNS, len(WALL) // COLUMNS), TILE_M, DISTANCE_M)],
                 seed=arguments.seed)
    (work / "scene.yaml").write_text(yaml.safe_dump(scene, sort_keys=False))
    frames = ["--frames", "12", "--first-frame", "40", "--step", "6"] if arguments.quick else []
    subprocess.run([str(arguments.program), str(work / "scene.yaml"), str(work), "--max-features",
                    str(arguments.max_features), "--image-period", "5", *frames], check=True)


def read_truth(folder):
    truth = {}
    with open(folder / "truth.csv") as file:
        for row in csv.DictReader(file):
            q = numpy.array([float(row[k]) for k in ("qw", "qx", "qy", "qz")])
            truth[f"frame_{int(row['frame']):04d}"] = {
                "t_s": float(row["t_s"]), "R_world_cam": rotation_matrix(q),
                "position": numpy.array([float(row[k]) for k in ("x_m", "y_m", "z_m")]),
                "extent_px": float(row["median_extent_px"]),
                "features": {folder: int(row[f"keypoints_{folder}"]) for folder in ("blurred", "deblurred")}}
    with open(folder / "camera.csv") as file:
        camera = {key: float(value) for key, value in next(csv.DictReader(file)).items()}
    return truth, camera
