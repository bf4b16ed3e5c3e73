#!/usr/bin/python3
"""Draws the figures of doc/design from recorded data (test/data/README.md): a phone's gyroscope and photographs.

The rules are those of the sources, written again in NumPy. Figures change when a rule or its constants do.
"""

import argparse
import io
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
# The script is not installed.
sys.path.insert(0, str(ROOT / "scripts"))
import missing_packages  # noqa: E402,F401  (first: names the package of a module that is missing)

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

INSTANTS = 9  # of a path, from start to end of the exposure
FOCAL_PX, WIDTH_PX, HEIGHT_PX, BLOCK_PX = 460.0, 752, 480, 64
EXPOSURE_S, READOUT_S = 0.03, 0.02
RATIO = 0.01  # noise_to_signal_ratio
BLUE, ORANGE, GREEN, RED, GREY = "tab:blue", "tab:orange", "tab:green", "tab:red", "0.55"


class Shake:
    """Rotation of a camera with the axes of a recorded gyroscope."""

    STEP_S = 0.0005

    def __init__(self, data):
        table = np.loadtxt(data / "handshake_gyro" / "gyro_test.txt")
        self.times_s = (table[:, 0] - table[0, 0]) * 1e-9
        self.rates_rad_s = table[:, 1:4]

    def rotations(self, first_s, times_s):
        """Takes directions at first_s to those at times_s, which are not before it."""
        last_s = max(times_s) + self.STEP_S
        grid_s = np.arange(first_s, last_s + self.STEP_S, self.STEP_S)
        rates = np.stack([np.interp(grid_s + self.STEP_S / 2, self.times_s, self.rates_rad_s[:, i]) for i in range(3)],
                         axis=1)
        rotation, result, k = np.eye(3), [], 0
        for time_s in times_s:
            while k + 1 < len(grid_s) and grid_s[k + 1] <= time_s + 1e-9:
                rotation = rotation_matrix(-self.STEP_S * rates[k]) @ rotation
                k += 1
            result.append(rotation_matrix(-(time_s - grid_s[k]) * rates[k]) @ rotation)
        return result

    def path(self, place_px, start_s, exposure_s=EXPOSURE_S, row_time_s=0.0):
        """Places [px] of a scene point that is at place_px at the middle of the exposure, from there."""
        center_px = np.array([(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2])
        ray = np.append((np.asarray(place_px) - center_px) / FOCAL_PX, 1)
        path_px = np.zeros((INSTANTS, 2))
        for _ in range(5 if row_time_s else 1):
            times_s = np.linspace(start_s, start_s + exposure_s, INSTANTS) + row_time_s * path_px[:, 1]
            rotations = self.rotations(times_s[0], times_s)
            rotated = np.array([rotation @ rotations[INSTANTS // 2].T @ ray for rotation in rotations])
            path_px = FOCAL_PX * rotated[:, :2] / rotated[:, 2:] + center_px - place_px
        return path_px


def rotation_matrix(vector_rad):
    """Rotation matrix of a rotation vector."""
    angle = np.linalg.norm(vector_rad)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def photograph(data, name):
    """Grey levels, 0 to 255."""
    image = plt.imread(data / "oxford_affine" / name / "img1.png")
    grey = image if image.ndim == 2 else image[..., :3] @ [0.299, 0.587, 0.114]
    return 255.0 * grey


class Line:
    """The line that lies nearest to a path, and what the path departs from it."""

    def __init__(self, path_px):
        values, vectors = np.linalg.eigh(np.cov((path_px - path_px.mean(axis=0)).T))
        self.direction = vectors[:, np.argmax(values)]
        self.normal = np.array([-self.direction[1], self.direction[0]])
        self.along_px, across_px = path_px @ self.direction, path_px @ self.normal
        self.across_middle_px = (across_px.max() + across_px.min()) / 2
        self.extent_px = np.ptp(self.along_px)
        uniform_px = np.linspace(self.along_px[0], self.along_px[-1], INSTANTS)
        self.nonuniformity_px = np.ptp(self.along_px - uniform_px) / 2
        self.curvature_px = np.ptp(across_px) / 2 - 0.02 * self.extent_px

    def is_nonuniform(self):
        return self.nonuniformity_px > max(0.25, (self.extent_px / 40) ** 2)

    def is_curved(self):
        return self.curvature_px > 0.8


def share_within(path_px, begin_px, end_px):
    """Share of the exposure that a path along a line spends between two places."""
    share = 0
    for a, b in zip(path_px, path_px[1:]):
        low, high = min(a, b), max(a, b)
        share += max(0, min(high, end_px) - max(low, begin_px)) / max(high - low, 1e-9)
    return share / (len(path_px) - 1)


def transfer(path_px, fx, fy):
    """Transfer function of a path at fx, fy [cycles/px]: straight and uniform between its places."""
    total = 0
    for a, b in zip(path_px, path_px[1:]):
        middle, moved = (a + b) / 2, b - a
        total = total + np.sinc(fx * moved[0] + fy * moved[1]) * np.exp(-2j * np.pi * (fx * middle[0] + fy * middle[1]))
    return total / (len(path_px) - 1)


def straight(extent_px, angle_rad=0.0):
    """A straight path of uniform speed."""
    return np.outer(np.linspace(-0.5, 0.5, INSTANTS) * extent_px, [np.cos(angle_rad), np.sin(angle_rad)])


def blurred(image, path_px):
    """Edges wrap around: to be cut off."""
    fy, fx = np.meshgrid(np.fft.fftfreq(image.shape[0]), np.fft.fftfreq(image.shape[1]), indexing="ij")
    return np.real(np.fft.ifft2(np.fft.fft2(image) * transfer(path_px, fx, fy)))


def save(figure, folder, name, colors=256):
    figure.tight_layout()
    pixels = io.BytesIO()
    figure.savefig(pixels, dpi=100)
    plt.close(figure)
    # A palette takes a third of the bytes.
    Image.open(pixels).convert("RGB").quantize(colors, dither=Image.NONE).save(folder / f"{name}.png", optimize=True)
    print(folder / f"{name}.png")


def show(axes, image, title, **arguments):
    axes.imshow(image, interpolation="nearest", **{"cmap": "gray", "vmin": 0, "vmax": 255, **arguments})
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


# ---------------------------------------------------------------------------------------------------------------------


START_S = 18.49  # of a part of the recording with straight and curved paths in one image


def blur_model(data, folder):
    shake = Shake(data)
    figure, (field, one, taps) = plt.subplots(1, 3, figsize=(9, 3.3), width_ratios=(2.1, 1, 1))
    chosen = None
    for top in range(0, HEIGHT_PX, BLOCK_PX):
        for left in range(0, WIDTH_PX, BLOCK_PX):
            place_px = np.array([(left + min(left + BLOCK_PX, WIDTH_PX) - 1) / 2,
                                 (top + min(top + BLOCK_PX, HEIGHT_PX) - 1) / 2])
            path_px = shake.path(place_px, START_S + READOUT_S * place_px[1] / HEIGHT_PX,
                                 row_time_s=READOUT_S / HEIGHT_PX)
            line = Line(path_px)
            color = ORANGE if line.is_curved() else BLUE if line.is_nonuniform() else GREEN
            field.plot(*(place_px + path_px).T, color=color, linewidth=1.8)
            field.plot(*place_px, ".", color="black", markersize=2.5)
            if (left, top) == (5 * BLOCK_PX, 4 * BLOCK_PX):
                chosen = place_px, path_px, line
    place_px, path_px, line = chosen
    field.add_patch(plt.Rectangle(place_px - BLOCK_PX / 2, BLOCK_PX, BLOCK_PX, fill=False, color="black"))
    field.set(xlim=(0, WIDTH_PX), ylim=(HEIGHT_PX, 0), aspect="equal", xticks=range(0, WIDTH_PX, 128),
              yticks=range(0, HEIGHT_PX, 128), xlabel="x [px]", ylabel="y [px]")
    for color, text in ((GREEN, "straight, uniform"), (BLUE, "straight, non-uniform"), (ORANGE, "curved")):
        field.plot([], [], color=color, linewidth=2, label=text)
    field.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, 1.16), ncol=3, columnspacing=1, handlelength=1.2)

    ends = np.array([line.along_px.min(), line.along_px.max()])
    base = line.across_middle_px * line.normal
    one.plot(*path_px.T, "o-", color=ORANGE if line.is_curved() else BLUE, markersize=3.5, label="path, 9 instants")
    one.plot(*(base + np.outer(ends, line.direction)).T, color="black", linewidth=0.9, label="nearest line")
    limit_px = 0.8 + 0.02 * line.extent_px
    for i, side in enumerate((-limit_px, limit_px)):
        one.plot(*(base + side * line.normal + np.outer(ends, line.direction)).T, ":", color="black", linewidth=0.9,
                 label=f"curved beyond $\\pm${limit_px:.1f} px" if i == 0 else None)
    one.plot(0, 0, "s", color=RED, markersize=4, label="middle of exposure")
    one.set(xlabel="dx [px]", ylabel="dy [px]", aspect="equal", adjustable="datalim")
    one.invert_yaxis()
    one.legend(fontsize=6.5, loc="upper left", borderpad=0.2)
    for axes in (field, one, taps):
        axes.tick_params(labelsize=7)

    places_px = np.arange(int(ends[0]) - 4, int(ends[1]) + 5)
    psf = [share_within(line.along_px, x - 0.5, x + 0.5) for x in places_px]
    taps.step(places_px, psf, where="mid", color=BLUE, label="PSF of the path")
    box_px = places_px[0] - 1 + np.array([0, 1])
    middle_px, half_px = ends.mean(), line.extent_px / 2
    box_px = [places_px[0], middle_px - half_px, middle_px - half_px, middle_px + half_px, middle_px + half_px,
              places_px[-1]]
    taps.plot(box_px, np.array([0, 0, 1, 1, 0, 0]) / line.extent_px, color=GREEN, label="box of the extent")
    taps.set(xlabel="along the line [px]", ylabel="share of the exposure", ylim=(0, 1.45 * max(psf)))
    taps.legend(fontsize=7, loc="upper center")
    save(figure, folder, "blur_model")


# ---------------------------------------------------------------------------------------------------------------------


def toeplitz(lags):
    n = len(lags)
    return np.asarray(lags)[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]


def inverse_of_box(extent_px):
    """1-D filter of a straight, uniform path: regularization fixed, filter_length_factor 4."""
    length = int(np.ceil(4 * extent_px)) // 2 * 2 + 1
    radius = length // 2
    x = np.arange(-radius, radius + 1)
    box = np.clip(np.minimum(x + 0.5, extent_px / 2) - np.maximum(x - 0.5, -extent_px / 2), 0, None) / extent_px
    share = max(0.0, 1 - extent_px / 36)
    lags = np.correlate(box, box, "full")[length - 1:].copy()
    lags[0] += RATIO * (1 + share)
    lags[1] -= RATIO * share
    solved = np.linalg.solve(toeplitz(lags), np.stack([box, np.ones(length)], axis=1))
    multiplier = (1 / (1 + RATIO * (1 - share)) - solved[:, 0].sum()) / solved[:, 1].sum()
    taps = solved[:, 0] + multiplier * solved[:, 1]
    return taps / taps.sum()


class TwoScales:
    """Coarse weights and boxes nearest to a filter along an axis."""

    def __init__(self, taps, extent_px):
        self.box_half = int((extent_px - 1) // 2)
        self.node = max(2, round(2 * (self.box_half + 1) / 15))
        self.radius = -(-(len(taps) // 2) // self.node)
        reach = (self.radius + 3) * self.node
        self.x = np.arange(-reach, reach + 1)
        wanted = np.zeros(len(self.x))
        wanted[reach - len(taps) // 2:reach + len(taps) // 2 + 1] = taps
        covariance = toeplitz(self.correlation(len(self.x)))
        self.parts = [self.columns(phase) for phase in range(self.node)]
        normal = sum(part.T @ covariance @ part for part in self.parts)
        right = sum(part.T @ covariance @ wanted for part in self.parts)
        sums = self.parts[0].sum(axis=0)
        free, along = np.linalg.solve(normal, np.stack([right, sums], axis=1)).T
        self.weights = free + along * (wanted.sum() - sums @ free) / (sums @ along)
        self.wanted = wanted

    def correlation(self, count):
        """Of a blurred photograph with noise, by lag."""
        period = 4096
        f = np.arange(period) / period
        image = (1 - 0.95**2) / (1 + 0.95 * (0.95 - 2 * np.cos(2 * np.pi * f)))
        box = np.zeros(period)
        box[np.arange(-self.box_half, self.box_half + 1)] = 1 / (2 * self.box_half + 1)
        power = 2500 * image * np.abs(np.fft.fft(box)) ** 2 + 1 + 1 / 12
        return np.real(np.fft.ifft(power))[:count]

    def columns(self, phase):
        """What each weight adds to the taps of an output at this place in its node."""
        u = (phase - (self.node - 1) / 2) / self.node
        spline = ((0.5 - u) ** 2 / 2, 0.75 - u**2, (0.5 + u) ** 2 / 2)
        columns = np.zeros((len(self.x), self.radius + 3))
        node_of = (self.x + phase) // self.node
        for k in range(-self.radius, self.radius + 1):
            for s in (-1, 0, 1):
                columns[node_of == k + s, abs(k)] += spline[s + 1]
        for i in range(2):
            columns[np.abs(self.x) <= self.box_half + i, self.radius + 1 + i] = 1
        return columns

    def taps(self, phase, parts=slice(None)):
        return self.parts[phase][:, parts] @ self.weights[parts]


def two_scale_filter(data, folder):
    extent_px = 60
    taps = inverse_of_box(extent_px)
    two = TwoScales(taps, extent_px)
    coarse, boxes = slice(0, two.radius + 1), slice(two.radius + 1, None)
    figure, (whole, split, error) = plt.subplots(1, 3, figsize=(9, 3), width_ratios=(1.25, 1.25, 1))
    inside = np.abs(two.x) <= len(taps) // 2
    whole.step(two.x[inside], two.wanted[inside], where="mid", color="black", linewidth=1)
    whole.set(xlabel="along the line [px]", ylabel="tap", title=f"1-D filter: {len(taps)} taps")
    phase = two.node // 2
    split.step(two.x, two.taps(phase, boxes), where="mid", color=BLUE, label="two boxes: running sums")
    split.step(two.x, two.taps(phase, coarse), where="mid", color=ORANGE, linewidth=1,
               label=f"{2 * two.radius + 1} coarse weights {two.node} px\napart: B-spline")
    split.set(xlabel="along the line [px]", title="the same as a sum of two scales")
    span = np.ptp(taps)
    split.set_ylim(split.get_ylim()[0], split.get_ylim()[1] + 0.75 * span)
    split.legend(fontsize=7, loc="upper center")
    row = blurred(photograph(data, "boat"), straight(extent_px))[300]
    row = np.round(row + np.random.default_rng(1).normal(0, 1, row.shape))
    ends_px = len(two.x) // 2
    places_px = np.arange(ends_px, len(row) - ends_px)
    near = row[places_px[:, None] + two.x]
    output = near @ two.wanted
    of_scales = np.array([values @ two.taps(x % two.node) for x, values in zip(places_px, near)])
    error.plot(places_px, output, color="black", linewidth=0.8, label="filter")
    error.plot(places_px, of_scales - output, color=RED, linewidth=0.8,
               label=f"two scales less filter, RMS {np.std(of_scales - output):.1f}")
    error.set(xlabel="x [px]", ylabel="grey levels", title="a deblurred row", ylim=(-30, 380))
    error.legend(fontsize=7, loc="upper center")
    for axes in (whole, split, error):
        axes.grid(alpha=0.3)
        axes.title.set_fontsize(9)
    save(figure, folder, "two_scale_filter")


# ---------------------------------------------------------------------------------------------------------------------


def curved_path(shake, start_s=4.74):
    return shake.path(np.array([352.0, 288.0]), start_s)


def wiener(path_px, shape, ratio=RATIO):
    """Gain of the 2-D filter."""
    fy, fx = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.fftfreq(shape[1]), indexing="ij")
    h = transfer(path_px, fx, fy)
    noise = 0.3 * ratio + 0.7 * ratio * 36 * (fx**2 + fy**2)
    return h, (1 + 0.3 * ratio) * np.conj(h) / (np.abs(h) ** 2 + noise)


def fourier_filter(data, folder):
    path_px = curved_path(Shake(data))
    random = np.random.default_rng(1)
    image = photograph(data, "graf")[150:150 + 384, 130:130 + 384]
    noisy = np.round(blurred(image, path_px) + random.normal(0, 2, image.shape))
    line = Line(path_px)
    chord = np.outer(np.linspace(-0.5, 0.5, INSTANTS) * line.extent_px, line.direction) + path_px.mean(axis=0)
    figure, axes = plt.subplots(2, 4, figsize=(9, 5))
    (psf_axes, h_axes, g_axes, window_axes), pictures = axes
    size = 15
    fine = np.concatenate([np.linspace(a, b, 60, endpoint=False) for a, b in zip(path_px, path_px[1:])])
    psf, _, _ = np.histogram2d(fine[:, 1], fine[:, 0], bins=np.arange(-size - 0.5, size + 1), density=True)
    psf_axes.imshow(psf, cmap="gray_r", extent=(-size, size, size, -size))
    psf_axes.plot(*path_px.T, ".", color=ORANGE, markersize=4)
    psf_axes.set(xlabel="dx [px]", ylabel="dy [px]", title="path and PSF")
    spectra = wiener(path_px, (192, 192))
    for panel, values, title, limits in ((h_axes, spectra[0], "$|H|$ [dB]", (-40, 0)),
                                         (g_axes, spectra[1], "$|G|$ [dB]", (-20, 20))):
        shown = panel.imshow(np.fft.fftshift(20 * np.log10(np.abs(values) + 1e-6)), cmap="viridis", vmin=limits[0],
                             vmax=limits[1], extent=(-0.5, 0.5, 0.5, -0.5))
        figure.colorbar(shown, ax=panel, fraction=0.046, pad=0.03).ax.tick_params(labelsize=7)
        panel.set(xlabel="$f_x$ [cycles/px]", title=title)
    x = np.arange(-32, 96 + 64)
    for i, color in enumerate((GREY, BLUE, GREY)):
        place = (x - (i - 1) * 64 + 32) / 128
        weight = np.where((place > 0) & (place < 1), np.sin(np.pi * place) ** 2, 0)
        window_axes.plot(x - 32, weight, color=color)
    window_axes.axvspan(0 - 32, 64 - 32, color=BLUE, alpha=0.12)
    window_axes.set(xlabel="x [px]", title="windows of 3 cells", yticks=(0, 1), ylim=(0, 1.15))
    gain = wiener(chord, image.shape)[1], wiener(path_px, image.shape)[1]
    results = [image, noisy] + [np.real(np.fft.ifft2(np.fft.fft2(noisy) * each)) for each in gain]
    cut = slice(110, 110 + 150)
    for panel, result, title in zip(pictures, results, ("sharp", "blurred, noise 2", "as a straight path",
                                                        "2-D filter")):
        error = np.sqrt(np.mean((result[64:-64, 64:-64] - image[64:-64, 64:-64]) ** 2))
        show(panel, result[cut, cut], title + (f": RMSE {error:.0f}" if result is not image else ""))
    for panel in axes[0]:
        panel.title.set_fontsize(9)
        panel.tick_params(labelsize=7)
    save(figure, folder, "fourier_filter", colors=64)


# ---------------------------------------------------------------------------------------------------------------------


class VelocityPlane:
    """Velocities about a place, robust: weights of Geman and McClure, times nearness."""

    def __init__(self, places_px, velocities_px_s, center_px, count=20):
        distance2 = ((places_px - center_px) ** 2).sum(axis=1)
        self.nearest = np.argsort(distance2)[:count]
        offsets = places_px[self.nearest] - center_px
        velocities = velocities_px_s[self.nearest]
        distance2 = distance2[self.nearest]
        nearness = 1 / (1 + distance2 / (0.3 * distance2.max()))
        rows = np.column_stack([np.ones(count), offsets])
        self.coefficients = np.zeros((3, 2))
        for axis in range(2):
            order = np.argsort(velocities[:, axis])
            half = np.searchsorted(np.cumsum(nearness[order]), nearness.sum() / 2)
            self.coefficients[0, axis] = velocities[order[half], axis]
        for _ in range(3):
            off = np.linalg.norm(velocities - rows @ self.coefficients, axis=1)
            spread = max(np.median(off) / 1.1774, 1e-3)
            self.belief = (1 + (off / (2 * spread)) ** 2) ** -2
            self.weights = self.belief * nearness
            normal = rows.T @ (self.weights[:, None] * rows) + np.diag([0, 1, 1]) * 0.02 * distance2.max()
            self.coefficients = np.linalg.solve(normal, rows.T @ (self.weights[:, None] * velocities))
        self.velocity_px_s = self.coefficients[0]


def optical_flow(data, folder):
    del data
    random = np.random.default_rng(3)
    period_s = 0.05
    camera_m_s = np.array([0.5, 0.12, 0.25])

    def true_velocity(places_px, object_):
        center = np.array([(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2])
        ray = (places_px - center) / FOCAL_PX
        depth_m = 3.2 - 1.4 * ray[:, 1:]
        velocity = FOCAL_PX / depth_m * (-camera_m_s[:2] + camera_m_s[2] * ray)
        velocity[object_] = (150, -60)
        return velocity

    def is_on_object(places_px):
        return (np.abs(places_px - (500, 230)) < (75, 70)).all(axis=1)

    cells = np.stack(np.meshgrid(np.arange(24, WIDTH_PX - 16, 40), np.arange(24, HEIGHT_PX - 16, 40)), axis=-1)
    places_px = cells.reshape(-1, 2) + random.uniform(-14, 14, (cells.size // 2, 2))
    on_object = is_on_object(places_px)
    velocities = true_velocity(places_px, on_object) + random.normal(0, 0.25, places_px.shape) / period_s
    wrong = random.uniform(size=len(places_px)) < 0.04
    velocities[wrong] += random.normal(0, 120, (wrong.sum(), 2))
    figure, (field, line, time) = plt.subplots(1, 3, figsize=(9, 3.1), width_ratios=(1.75, 1, 1))
    shown_s = 0.4
    arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / shown_s}
    field.quiver(*places_px.T, *velocities.T, color="0.6", width=0.0028, label="corners", **arrows)
    centers = np.array([(left + min(left + BLOCK_PX, WIDTH_PX) - 1, top + min(top + BLOCK_PX, HEIGHT_PX) - 1)
                        for top in range(0, HEIGHT_PX, BLOCK_PX) for left in range(0, WIDTH_PX, BLOCK_PX)]) / 2
    planes = [VelocityPlane(places_px, velocities, center) for center in centers]
    of_blocks = np.array([plane.velocity_px_s for plane in planes])
    field.quiver(*centers.T, *of_blocks.T, color=BLUE, width=0.0045, label="blocks", **arrows)
    field.add_patch(plt.Rectangle((425, 160), 150, 140, fill=False, color=ORANGE, linewidth=1.5))
    field.text(428, 318, "object", color=ORANGE, fontsize=8)
    field.set(xlim=(0, WIDTH_PX), ylim=(HEIGHT_PX, 0), aspect="equal", xlabel="x [px]", ylabel="y [px]",
              title=f"displacement by the residual velocity in {shown_s} s")
    field.legend(fontsize=7, loc="lower right")

    chosen = int(np.argmin(((centers - (415, 160)) ** 2).sum(axis=1)))
    plane = planes[chosen]
    field.add_patch(plt.Rectangle(centers[chosen] - 32, 64, 64, fill=False, color="black"))
    offset = places_px[plane.nearest] - centers[chosen]
    sizes = 6 + 60 * plane.belief
    line.scatter(offset[:, 0], velocities[plane.nearest, 0], s=sizes, color="0.6", edgecolor="black", linewidth=0.5)
    x = np.array([offset[:, 0].min(), offset[:, 0].max()])
    line.plot(x, plane.coefficients[0, 0] + plane.coefficients[1, 0] * x, color=BLUE)
    line.plot(0, plane.velocity_px_s[0], "s", color=BLUE, markersize=6)
    line.set(xlabel="from the block's centre [px]", ylabel="x velocity [px/s]", title="a block's 20 corners")
    t = np.linspace(-0.105, 0.02, 200)

    def speed(at_s):
        return 140 + 900 * at_s - 4000 * at_s**2

    time.plot(1000 * t, speed(t), color="black", linewidth=1, label="true")
    means = []
    for k in (1, 0):
        begin_s, end_s = -(k + 1) * period_s, -k * period_s
        means.append(np.mean(speed(np.linspace(begin_s, end_s, 500))))
        time.plot(1000 * np.array([begin_s, end_s]), 2 * [means[-1]], color=BLUE, linewidth=2,
                  label="mean between images" if k else None)
    carried = means[1] + (means[1] - means[0]) / 2
    time.plot([-25, 0], [means[1], carried], "--", color=BLUE, linewidth=1.2)
    time.plot(0, carried, "s", color=BLUE, label="at the exposure")
    time.axvspan(-15, 15, color=GREY, alpha=0.25)
    time.set(xlabel="time from the image [ms]", ylabel="velocity [px/s]", title="from means to the exposure")
    time.legend(fontsize=7, loc="lower right")
    for axes in (field, line, time):
        axes.title.set_fontsize(9)
        axes.tick_params(labelsize=7)
    save(figure, folder, "optical_flow")


# ---------------------------------------------------------------------------------------------------------------------


class Likelihood:
    """The spectrum of a window, and how likely it is with more or less blur than predicted."""

    SIZE, WAVES, LESS = 64, 16, (0, 0.15, 0.33, 0.5)
    SECTORS, SECTOR_STDDEV, EXPONENT_STDDEV = 8, 1, 0.5

    def __init__(self, window, noise, extent_px, angle_rad):
        n = self.SIZE
        hann = np.sqrt(2 / 3) * (1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n))
        power = np.abs(np.fft.fft2((window - window.mean()) * np.outer(hann, hann))) ** 2 / n**2
        y, x = np.meshgrid(np.arange(-self.WAVES + 1, self.WAVES), np.arange(self.WAVES), indexing="ij")
        used = (x * x + y * y >= 4) & ~((y < 0) & (x == 0)) & ((y >= 0) | (x > 0))
        x, y = x[used], y[used]
        self.variance = 1.15 * 0.6102 * (noise**2 + 1 / 12)
        self.power = power[y, x] / self.variance
        self.texture = (x * x + y * y) ** -1.25
        self.along = np.abs(x * np.cos(angle_rad) + y * np.sin(angle_rad))
        self.extent_px = extent_px
        turned_rad = (np.arctan2(y, x) + np.pi / 2 / self.SECTORS) % np.pi
        sector = np.argsort(np.argsort(turned_rad, kind="stable")) * self.SECTORS // len(x)
        log_frequency = np.log(np.hypot(x, y))
        self.basis = np.column_stack([np.ones(len(x)), log_frequency - log_frequency.mean(),
                                      sector[:, None] == np.arange(self.SECTORS)])
        self.precision = np.array([1e-6, self.EXPONENT_STDDEV**-2] + [self.SECTOR_STDDEV**-2] * self.SECTORS)

    def gain(self, share, along=None):
        along = self.along if along is None else along

        def squared(waves):
            return np.sinc(share * self.extent_px * waves / self.SIZE) ** 2

        return (4 * squared(along) + squared(along - 1) + squared(along + 1)) / 6 + 0.003

    def cost(self, share, steps=12):
        """The least cost, and the power of the texture that has it."""
        model = self.texture * self.gain(share)
        fit = np.zeros(len(self.precision))
        fit[0] = np.log(max(self.power.mean() - 1, 0.05) / model.mean())
        for _ in range(steps):
            above = np.exp(self.basis @ fit) * model
            weight = above / (above + 1)
            gradient = self.basis.T @ (weight * (above + 1 - self.power) / (above + 1 + self.power))
            information = self.basis.T @ (weight[:, None] ** 2 / 3 * self.basis) + np.diag(self.precision)
            fit -= np.clip(np.linalg.solve(information, gradient + self.precision * fit), -2, 2)
        texture = np.exp(self.basis @ fit) * self.texture
        spectrum = texture * self.gain(share) + 1
        cost = (2 * np.log(spectrum + self.power) - np.log(spectrum)).sum() + (self.precision * fit**2).sum() / 2
        return cost, texture

    def log_ratio(self):
        cost = self.cost(1)[0]
        more = np.array([self.cost(share)[0] - cost for share in self.LESS])
        return more.min() - np.log(np.mean(np.exp(more.min() - more)))


def validation(data, folder):
    random = np.random.default_rng(1)
    image = photograph(data, "graf")[:, 16:16 + 768]
    extent_px, angle_rad, noise = 12.0, 0.35, 2.0
    thirds = (blurred(image, straight(extent_px, angle_rad)), blurred(image, straight(extent_px / 3, angle_rad)), image)
    mixed = np.concatenate([part[:, 256 * i:256 * (i + 1)] for i, part in enumerate(thirds)], axis=1)
    mixed = np.clip(np.round(mixed + random.normal(0, noise, mixed.shape)), 0, 255)
    figure, (spectrum, picture, counts) = plt.subplots(1, 3, figsize=(9, 3.2), width_ratios=(1.1, 1.2, 1))
    blocks = [Likelihood(mixed[top:top + 64, left:left + 64], noise, extent_px, angle_rad)
              for top in range(0, 640, 64) for left in range(0, 256, 64)]
    waves = np.arange(1, 15)

    def along_motion(power_of):
        """Geometric mean over the blocks."""
        logarithms = [np.log(power_of(block) / block.texture) for block in blocks]
        return np.exp([np.mean([values[np.abs(block.along - w) < 0.6].mean()
                                for block, values in zip(blocks, logarithms)]) for w in waves])

    euler = 0.5772  # the logarithm of an exponential distribution is lower by this on average
    spectrum.plot(waves / 64, along_motion(lambda block: block.power) * np.exp(euler), "o", color="black",
                  markersize=4, label="blocks of the left third")
    for share, color, text in ((1, BLUE, "predicted blur"), (0.5, ORANGE, "half of it"), (0.33, RED, "a third"),
                               (0, GREY, "none")):
        model = along_motion(lambda block: block.cost(share)[1] * block.gain(share) + 1)
        spectrum.plot(waves / 64, model, color=color, label=text)
    spectrum.set(yscale="log", xlabel="frequency along the motion [cycles/px]", ylabel="power / texture",
                 title="power spectrum, and models")
    spectrum.legend(fontsize=6.5)
    show(picture, mixed, "blurred by 12 px | 4 px | sharp; predicted 12 px")
    ratios, threshold = np.zeros((10, 12)), 14 * np.log(0.025 / 0.1)
    for row in range(10):
        for col in range(12):
            window = mixed[64 * row:64 * (row + 1), 64 * col:64 * (col + 1)]
            ratios[row, col] = Likelihood(window, noise, extent_px, angle_rad).log_ratio()
            accepted = ratios[row, col] > threshold
            picture.add_patch(plt.Rectangle((64 * col + 4, 64 * row + 4), 55, 55, fill=False, linewidth=1.3,
                                            color=GREEN if accepted else RED))
    for i, (color, text) in enumerate(((BLUE, "12 px"), (RED, "4 px"), (GREY, "sharp"))):
        counts.hist(np.clip(ratios[:, 4 * i:4 * i + 4].ravel(), -150, 150), bins=np.arange(-150, 151, 12), color=color,
                    alpha=0.6, label=text)
    counts.axvline(threshold, color="black", linestyle="--", linewidth=1)
    counts.set(xlabel="log likelihood ratio of a block alone", ylabel="blocks",
               title="dashed: threshold of the default")
    counts.legend(fontsize=7)
    for axes in (spectrum, picture, counts):
        axes.title.set_fontsize(8.5)
        axes.tick_params(labelsize=7)
    save(figure, folder, "validation")


# ---------------------------------------------------------------------------------------------------------------------


class MotionSpectrum:
    """Power of a window of 128 px by the frequency along the motion, whitened."""

    SIZE, WAVES, FIRST = 128, 44, 2

    def __init__(self, window, extent_px, angle_rad, noise):
        n = self.SIZE
        hann = np.sqrt(2 / 3) * (1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n))
        power = np.abs(np.fft.fft2((window - window.mean()) * np.outer(hann, hann))) ** 2 / n**2
        v, u = np.meshgrid(np.arange(-self.WAVES, self.WAVES + 1), np.arange(1, self.WAVES + 1), indexing="ij")
        squared = u * u + v * v
        along = np.abs(u * np.cos(angle_rad) + v * np.sin(angle_rad))
        used = (squared <= self.WAVES**2) & (squared >= self.FIRST**2) & (along + 0.5 >= self.FIRST)
        white = squared[used] ** 1.25
        along, power, noise_power = along[used], power[v[used], u[used]] * white, (noise**2 + 1 / 12) * white
        point = (along + 0.5).astype(int)
        signal = np.ones(self.WAVES + 1)
        for _ in range(3):
            weight = 1 / (signal[point] + noise_power) ** 2
            total, power_sum, noise_sum, along_sum = (
                np.bincount(point, weight * values, minlength=self.WAVES + 1)
                for values in (np.ones(len(point)), power, noise_power, along))
            kept = total > 0
            mean, mean_noise = power_sum[kept] / total[kept], noise_sum[kept] / total[kept]
            signal[kept] = np.maximum(mean - mean_noise, 0.1 * mean_noise + 1e-9)
        kept &= np.bincount(point, minlength=self.WAVES + 1) >= 4
        self.frequency = along_sum[kept] / total[kept]
        self.power, self.noise = power_sum[kept] / total[kept], noise_sum[kept] / total[kept]
        self.variance = 1.94**2 / (total[kept] * self.power**2) + 0.05
        self.extent = extent_px / n

    def gain(self, ratio):
        def squared(waves):
            return np.sinc(ratio * self.extent * waves) ** 2

        side = 1 / 6 + 1 / 24
        return ((1 - 2 * side) * squared(self.frequency) +
                side * (squared(self.frequency - 1) + squared(self.frequency + 1)) + 0.003)


class RatioFit:
    """Texture common to all windows, an offset for each, and the depth of the zeros, for one ratio after another."""

    def __init__(self, spectra):
        self.spectra = spectra
        self.window = np.concatenate([np.full(len(s.power), i) for i, s in enumerate(spectra)])
        self.power, self.noise, self.variance, frequency = (
            np.concatenate([getattr(s, name) for s in spectra]) for name in ("power", "noise", "variance", "frequency"))
        x = np.log(frequency / 12)
        self.polynomial = np.stack([x, x**2, x**3], axis=1)
        self.offsets = np.zeros((len(x), len(spectra)))
        self.offsets[np.arange(len(x)), self.window] = 1
        start = [np.log(np.mean(np.maximum(s.power - s.noise, 0.1 * s.power))) for s in spectra]
        self.parameters = np.concatenate([[0, 0, 0, 1], start])

    def cost(self, ratio, steps=6):
        self.log_gain = np.log(np.concatenate([s.gain(ratio) for s in self.spectra]))
        columns = np.column_stack([self.polynomial, self.log_gain, self.offsets])
        precision = np.concatenate([[1, 4, 9, 11], np.full(len(self.spectra), 1e-6)])
        expected = np.concatenate([[0, 0, 0, 1], self.parameters[4:]])
        for _ in range(steps):
            signal = np.exp(columns @ self.parameters)
            share, error = signal / (signal + self.noise), np.log(self.power / (signal + self.noise))
            weight = np.minimum(1, 2.5 / (np.abs(error) / np.sqrt(self.variance) + 1e-6)) / self.variance * share
            normal = columns.T @ ((weight * share)[:, None] * columns) + np.diag(precision)
            right = columns.T @ (weight * error) + precision * (expected - self.parameters)
            self.parameters = self.parameters + np.clip(np.linalg.solve(normal, right), -2, 2)
        signal = np.exp(columns @ self.parameters)
        deviations = np.abs(np.log(self.power / (signal + self.noise))) / np.sqrt(self.variance)
        costs = np.where(deviations > 2.5, 2.5 * (deviations - 1.25), 0.5 * deviations**2)
        return np.bincount(self.window, costs)

    def texture(self):
        """Logarithm of the power that the signal would have without blur."""
        return self.polynomial @ self.parameters[:3] + self.offsets @ self.parameters[4:]


def exposure(data, folder):
    random = np.random.default_rng(2)
    image = photograph(data, "boat")
    noise, assumed = 2.0, 0.6  # of the true exposure
    windows, spectra = 4, []
    center_px = np.array([image.shape[1], image.shape[0]]) / 2
    for top in np.linspace(40, image.shape[0] - 168, windows).astype(int):
        for left in np.linspace(40, image.shape[1] - 168, windows).astype(int):
            # A camera that yaws and rolls.
            place_px = np.array([left, top]) + 64 - center_px
            moved_px = np.array([15.0, 4.0]) + 0.008 * np.array([-place_px[1], place_px[0]])
            extent_px, angle_rad = np.linalg.norm(moved_px), np.arctan2(moved_px[1], moved_px[0])
            part = image[top - 40:top + 168, left - 40:left + 168]
            part = blurred(part, straight(extent_px, angle_rad))[40:-40, 40:-40]
            part = np.clip(np.round(part + random.normal(0, noise, part.shape)), 0, 255)
            spectra.append(MotionSpectrum(part, assumed * extent_px, angle_rad, noise))
    fit = RatioFit(spectra)
    ratios = np.exp(np.arange(np.log(0.3), np.log(3), 0.02))
    costs = np.array([fit.cost(ratio) for ratio in ratios])
    limited = -np.log(0.98 * np.exp(-(costs - costs.min(axis=0))) + 0.02)
    total = limited.sum(axis=1)
    best = ratios[np.argmin(total)]
    figure, (spectrum, cost) = plt.subplots(1, 2, figsize=(9, 3.3), width_ratios=(1.35, 1))
    fit.cost(best, 12)
    for i, each in enumerate(spectra):
        own = fit.window == i
        signal = np.maximum(each.power - each.noise, 1e-3 * each.power)
        blur_db = 10 / np.log(10) * (np.log(signal) - fit.texture()[own])
        spectrum.plot(each.frequency * each.extent / assumed, blur_db, ".", color=GREY, markersize=3,
                      label="16 windows, texture and noise taken out" if i == 0 else None)
    u = np.linspace(0.05, 4.2, 400)
    spectrum.plot(u, 10 * np.log10(np.sinc(u) ** 2 + 0.003), color=BLUE, label=f"$|H|^2$ at the ratio {best:.2f}")
    spectrum.plot(u, 10 * np.log10(np.sinc(u * assumed) ** 2 + 0.003), "--", color=RED,
                  label="$|H|^2$ of the assumed exposure")
    spectrum.set(xlabel="frequency along the motion x true extent [cycles]", ylabel="$|H|^2$ [dB]", ylim=(-36, 12),
                 xlim=(0, 4.2), title="power spectra have the zeros of the path")
    spectrum.legend(fontsize=7, loc="upper right")
    cost.plot(ratios, total - total.min(), color=BLUE)
    cost.axvline(1 / assumed, color="black", linestyle="--", linewidth=1, label=f"true: {1 / assumed:.3f}")
    cost.axvline(1, color=RED, linestyle=":", linewidth=1.2, label="assumed")
    cost.set(xscale="log", xlabel="true over assumed exposure", ylabel="negative log likelihood, all windows",
             title="found as the least of the ratios searched")
    ticks = (0.3, 0.5, 1, 1.67, 3)
    cost.set_xticks(ticks)
    cost.set_xticklabels([str(tick) for tick in ticks])
    cost.minorticks_off()
    cost.legend(fontsize=7)
    for axes in (spectrum, cost):
        axes.title.set_fontsize(9)
        axes.grid(alpha=0.3)
    save(figure, folder, "exposure")


# ---------------------------------------------------------------------------------------------------------------------


def residuals(first, second, offsets_px, window_px=21):
    """Root mean square difference of a window of the first image and the shifted second, gain and offset fitted."""
    middle = np.array(first.shape) // 2
    half = window_px // 2
    rows, cols = np.mgrid[-half:half + 1, -half:half + 1]
    pattern = first[middle[0] + rows, middle[1] + cols]
    pattern = pattern - pattern.mean()
    surface = np.zeros((len(offsets_px), len(offsets_px)))
    f_y, f_x = np.meshgrid(np.fft.fftfreq(second.shape[0]), np.fft.fftfreq(second.shape[1]), indexing="ij")
    spectrum = np.fft.fft2(second)
    for i, dy in enumerate(offsets_px):
        for k, dx in enumerate(offsets_px):
            moved = np.real(np.fft.ifft2(spectrum * np.exp(2j * np.pi * (f_x * dx + f_y * dy))))
            patch = moved[middle[0] + rows, middle[1] + cols]
            patch = patch - patch.mean()
            gain = (pattern * patch).sum() / (pattern**2).sum()
            surface[i, k] = np.sqrt(np.mean((patch - gain * pattern) ** 2))
    return surface


def tracks(data, folder):
    shake = Shake(data)
    random = np.random.default_rng(4)
    top, left = TRACK_CORNER
    image = photograph(data, "boat")[top - 96:top + 96, left - 96:left + 96]
    place_px = np.array([200.0, 150.0])
    paths = [shake.path(place_px, start_s) for start_s in TRACK_STARTS_S]
    images = [np.round(blurred(image, path) + random.normal(0, 2, image.shape)) for path in paths]
    convolved = [blurred(images[0], paths[1]), blurred(images[1], paths[0])]
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.6), width_ratios=(1, 1, 1.25))
    offsets_px = np.arange(-4, 4.01, 0.25)
    cut = slice(96 - 32, 96 + 33)
    rows = ((images, "image before", "new image", axes[0], "as they are"),
            (convolved, "before, blurred by the new path", "new, blurred by the path before", axes[1],
             "after both convolutions"))
    for pair, first_title, second_title, panels, text in rows:
        for i, (panel, patch, title) in enumerate(zip(panels, pair, (first_title, second_title))):
            low, high = np.percentile(patch[cut, cut], (1, 99))
            show(panel, patch[cut, cut], title, vmin=low, vmax=high)
            panel.add_patch(plt.Rectangle((21.5, 21.5), 21, 21, fill=False, color=ORANGE, linewidth=1.5))
            if pair is images:
                panel.plot(*(paths[i] + 32).T, color=ORANGE, linewidth=1.5)
        surface = residuals(pair[0], pair[1], offsets_px)
        image_ = panels[2].imshow(surface, extent=(-4.125, 4.125, 4.125, -4.125), cmap="viridis_r")
        figure.colorbar(image_, ax=panels[2], fraction=0.046, pad=0.03, label="residual [grey levels]")
        row, col = np.unravel_index(np.argmin(surface), surface.shape)
        panels[2].plot(0, 0, "+", color="red", markersize=12, markeredgewidth=2, label="true place")
        panels[2].plot(offsets_px[col], offsets_px[row], "o", markerfacecolor="none", markeredgecolor="black",
                       markersize=9, markeredgewidth=1.5, label="least residual")
        panels[2].set(xlabel="dx [px]", ylabel="dy [px]")
        panels[2].set_title(text, fontsize=9)
        panels[2].legend(fontsize=7, loc="lower right")
    save(figure, folder, "tracks")


TRACK_CORNER, TRACK_STARTS_S = (490, 586), (16.95, 17.0)


# ---------------------------------------------------------------------------------------------------------------------


def frame_synchronization(data, folder):
    del data
    period, exposed, readout = 50.0, 20.0, 10.0  # [ms]
    stamps = period * np.arange(5)
    lost = 2
    infos = {i: stamp + exposed + 14 for i, stamp in enumerate(stamps) if i != lost}
    exposures = {i: stamp + exposed + 18 for i, stamp in enumerate(stamps)}
    images = stamps + exposed + readout + 8
    samples = np.arange(-10, 270, 5.0)
    arrivals = (np.ceil(samples / 10) * 10) + 4  # two to a packet
    ready = []
    for i, stamp in enumerate(stamps):
        end = stamp + exposed + readout
        imu = arrivals[samples >= end].min() if (samples >= end).any() else np.inf
        info = infos.get(i, infos.get(i + 1, np.inf))
        ready.append(max(images[i], info, exposures[i], imu))
    ready = np.maximum.accumulate(ready)
    figure, axes = plt.subplots(figsize=(9, 3.4))
    names = ("exposure of the rows", "image", "camera_info", "exposure message", "gyroscope samples", "ready")
    y = {name: len(names) - i for i, name in enumerate(names)}
    colors = plt.get_cmap("tab10").colors
    for i, stamp in enumerate(stamps):
        base = y["exposure of the rows"]
        axes.fill([stamp, stamp + exposed, stamp + exposed + readout, stamp + readout],
                  [base + 0.3, base + 0.3, base - 0.3, base - 0.3], color=colors[i], alpha=0.6)
        axes.plot(images[i], y["image"], "s", color=colors[i])
        if i in infos:
            axes.plot(infos[i], y["camera_info"], "o", color=colors[i])
        axes.plot(exposures[i], y["exposure message"], "^", color=colors[i])
        axes.plot(ready[i], y["ready"], "D", color=colors[i], markersize=7)
        axes.plot([images[i], ready[i]], [y["image"], y["ready"]], color=colors[i], linewidth=0.8, alpha=0.6)
    axes.plot(arrivals, np.full(len(arrivals), y["gyroscope samples"]), "|", color="black", markersize=9)
    x = stamps[lost] + exposed + 14
    axes.plot(x, y["camera_info"], "x", color=colors[lost], markersize=9, markeredgewidth=2)
    axes.annotate("lost", (x, y["camera_info"]), (x - 3, y["camera_info"] + 0.28), fontsize=8, color=colors[lost])
    axes.text(infos[lost + 1] - 3, y["camera_info"] - 0.45, "equal to the one before: replaces the lost one",
              fontsize=8, ha="right", color=colors[lost])
    axes.annotate("", (ready[lost], y["ready"] + 0.15), (infos[lost + 1], y["camera_info"] - 0.12),
                  arrowprops={"arrowstyle": "->", "color": colors[lost]})
    axes.set(yticks=list(y.values()), xlabel="time of arrival [ms]", xlim=(-5, 275), ylim=(0.4, len(names) + 0.6))
    axes.set_yticklabels(list(y))
    axes.grid(axis="x", alpha=0.3)
    save(figure, folder, "frame_synchronization")


# ---------------------------------------------------------------------------------------------------------------------


# Calls of one image: folder, function, depth, begin, end.
PATH_COLORS = {"ros": BLUE, "pipeline": ORANGE, "engine": GREEN, "base": GREY}
PATH_CALLS = (
    ("ros", "on_image", 1, 0, 22), ("ros", "guarded", 2, 0, 22), ("ros", "Processor::add_image", 3, 0, 22),
    ("ros", "add_image", 4, 1.5, 11.6), ("ros", "mark_ready", 4, 12, 22), ("ros", "push", 5, 6, 11.6),
    ("ros", "decide", 5, 12, 22), ("ros", "work", 1, 37, 141), ("ros", "guarded", 2, 39, 141),
    ("ros", "Processor::advance", 3, 40.5, 141), ("ros", "next_frame", 4, 40.5, 52.5),
    ("ros", "synchronize", 5, 40.5, 52.5), ("ros", "next", 6, 40.5, 52.5), ("ros", "decide", 7, 40.5, 46.4),
    ("ros", "collect", 7, 46.8, 52.5),
    ("ros", "Processor::process", 4, 52.9, 115), ("ros", "examine", 5, 54, 79.5),
    ("ros", "Processor::deblur", 5, 79.7, 115),
    ("ros", "Processor::validate", 6, 55.5, 76.1), ("pipeline", "estimate", 7, 55.5, 65.5),
    ("pipeline", "validate", 7, 69.1, 76.1),
    ("pipeline", "Pipeline::deblur", 6, 79.9, 102.4), ("ros", "add_result", 6, 102.8, 115),
    ("ros", "add_messages", 7, 104, 115), ("ros", "to_image", 8, 104, 115), ("pipeline", "deconvolve", 7, 80, 99),
    ("engine", "BlockEngine::filter", 8, 82, 99),
    ("engine", "filter_blocks", 9, 82, 98), ("engine", "run_tiles", 10, 82, 98), ("base", "parallel_for", 11, 82, 98),
    ("base", "parallel_for_ranges", 12, 82, 98), ("base", "Loop::step", 13, 82, 98),
    ("engine", "run_tile", 14, 82, 98), ("engine", "two_scale", 15, 82, 92), ("ros", "learn_from", 4, 115.4, 125.2),
    ("ros", "record", 4, 125.6, 132), ("ros", "sink", 4, 132.4, 141), ("ros", "publish", 5, 132.4, 141),
    ("ros", "Publishers", 6, 132.4, 141), ("ros", "Row", 7, 132.4, 141))
# Folder, name, top, begin.
PATH_STAGES = (("pipeline", "optical flow", 7.5, 55.5), ("pipeline", "blur field", 7.5, 58.9),
               ("pipeline", "exposure", 7.5, 62.3), ("ros", "choose_exposure", 6.5, 65.7),
               ("pipeline", "validation", 7.5, 69.1), ("pipeline", "noise", 7.5, 72.9), ("ros", "decide", 5.5, 76.5),
               ("pipeline", "keypoints", 6.5, 99.2))
PATH_LOCKS = (
    ("Processor::mutex_", ((0.8, 22), (37, 37.8), (40.8, 52.5), (66, 68.6), (116, 120), (125.6, 132))),
    ("GyroSource, InputProblems", ((2, 4.5), (13, 21), (42, 52), (117, 119), (127, 130))),
    ("StereoRig::mutex_", ((1, 2), (53.2, 54), (76.8, 79.4))),
    ("WorkSignal::mutex_", ((21, 22), (38, 39))),
    ("SelfCalibrator::mutex_", ((41, 42), (121, 123))),
    ("OnceMap (filters)", ((80.5, 81.5), (82.3, 83.3))),
    ("threads of parallel_for", ((83.7, 84.7), (97, 98))),
    ("DiagnosticReport::mutex_", ((132.8, 134.4),)),
    ("exposure_mutex_", ((39.2, 40.2),)))


def frame_path(data, folder):
    del data
    figure, axes = plt.subplots(figsize=(9, 6))
    for part, name, depth, begin, end in PATH_CALLS:
        axes.add_patch(plt.Rectangle((begin, depth - 0.5), end - begin, 1, facecolor=PATH_COLORS[part], alpha=0.3,
                                     edgecolor="white"))
        axes.text((begin + end) / 2, depth, name, ha="center", va="center", fontsize=6.2)
    for part, name, top, begin in PATH_STAGES:
        axes.add_patch(plt.Rectangle((begin, top), 3.2, 4.4, facecolor=PATH_COLORS[part], alpha=0.3, edgecolor="white"))
        axes.text(begin + 1.6, top + 2.2, name, ha="center", va="center", fontsize=6.2, rotation=90)
    arrow = {"arrowstyle": "->"}
    axes.annotate("", (37, 1.3), (22, 3), arrowprops=arrow)
    axes.text(27, 3.2, "wakes", fontsize=8, va="center")
    axes.annotate("loops over pixels", (92, 15), (101, 15), arrowprops=arrow, fontsize=8, va="center")
    first_lock = 17
    for row, (_, spans) in enumerate(PATH_LOCKS, first_lock):
        axes.axhline(row, color="0.9", linewidth=0.6, zorder=0)
        axes.broken_barh([(begin, end - begin) for begin, end in spans], (row - 0.3, 0.6), color=RED, alpha=0.7)
    for x, text in ((16, "nodelet manager's thread"), (89, "worker thread")):
        axes.text(x, -0.2, text, ha="center", va="center", fontsize=9)
    for part, color in PATH_COLORS.items():
        axes.add_patch(plt.Rectangle((0, 0), 0, 0, facecolor=color, alpha=0.3, label=f"src/{part}"))
    axes.add_patch(plt.Rectangle((0, 0), 0, 0, facecolor=RED, alpha=0.7, label="mutex held"))
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.02, 0.66))
    ticks = (1, 5, 10, 15)
    axes.set_yticks([*ticks, *range(first_lock, first_lock + len(PATH_LOCKS))])
    axes.set_yticklabels([*(f"depth {tick}" for tick in ticks), *(name for name, _ in PATH_LOCKS)], fontsize=8)
    axes.set(xlim=(-0.5, 141.5), ylim=(first_lock + len(PATH_LOCKS) - 0.4, -0.8), xticks=[])
    for side in "top", "right", "bottom":
        axes.spines[side].set_visible(False)
    save(figure, folder, "frame_path", colors=64)


FIGURES = {"blur_model": blur_model, "two_scale_filter": two_scale_filter, "fourier_filter": fourier_filter,
           "optical_flow": optical_flow, "validation": validation, "exposure": exposure, "tracks": tracks,
           "frame_synchronization": frame_synchronization, "frame_path": frame_path}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", nargs="*", help=f"some of {', '.join(FIGURES)}; all without")
    parser.add_argument("--data", type=pathlib.Path, default=ROOT.parent / "shared" / "data",
                        help="recorded data, with handshake_gyro/ and oxford_affine/")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path(__file__).parent / "images")
    arguments = parser.parse_args()
    unknown = set(arguments.figures) - set(FIGURES)
    if unknown:
        parser.error(f"there is no figure {', '.join(sorted(unknown))}")
    for needed in "handshake_gyro", "oxford_affine":
        if not (arguments.data / needed).is_dir():
            sys.exit(f"figures.py: there is no {arguments.data / needed}; see test/data/README.md")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.figures or FIGURES:
        FIGURES[name](arguments.data, arguments.out)


if __name__ == "__main__":
    main()
