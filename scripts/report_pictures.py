"""What report.py draws: frames before and after, the details in them, and curves over all frames."""
import os

import cv2
import matplotlib
import numpy as np

from report_bags import DEBLURRED, to_bgr, to_grey

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)


def label(image, text):
    """The image in BGR with a caption in its upper left corner."""
    out = to_bgr(image).copy()
    scale = max(0.5, out.shape[1] / 1200.0)
    thickness = max(1, int(round(scale)))
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    cv2.rectangle(out, (0, 0), (width + 12, height + base + 10), (0, 0, 0), -1)
    cv2.putText(out, text, (6, height + 6), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), thickness, cv2.LINE_AA)
    return out


def crop_windows(grey, mask, count, size):
    """The windows with most detail, apart from each other, inside the mask: (x, y) of their corners."""
    detail = np.abs(cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 1.5), cv2.CV_32F))
    detail[~mask] = 0
    score = cv2.boxFilter(detail, -1, size, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    score = score[:grey.shape[0] - size[1] + 1, :grey.shape[1] - size[0] + 1].copy()
    windows = []
    for _ in range(count):
        _, best, _, (x, y) = cv2.minMaxLoc(score)
        if best <= 0:
            break
        windows.append((x, y))
        score[max(0, y - size[1]):y + size[1], max(0, x - size[0]):x + size[0]] = 0
    return windows


class Pictures:
    """Before and after of the frames with most deblurred blur."""

    def __init__(self, folder, count):
        self.folder, self.count = folder, count
        self.kept = []  # (score, index, before, after, truth, overlay, mask)

    def offer(self, frame, overlay):
        """frame: a MeasuredFrame. overlay: an image, or None."""
        deblurred = frame.field.status == DEBLURRED
        if not np.any(deblurred):
            return
        score = float(np.mean(deblurred)) * float(np.median(frame.field.extent[deblurred]))
        self.kept.append((score, frame.index, frame.before, frame.after, frame.truth, overlay,
                          frame.field.mask(DEBLURRED)))
        self.kept.sort(key=lambda entry: -entry[0])
        del self.kept[self.count:]

    def write(self):
        """Files by frame, most blurred first."""
        files = []
        for _, index, before, after, truth, overlay, mask in self.kept:
            names = {"frame": index}

            def save(kind, image):
                names[kind] = "frame_%04d_%s.png" % (index, kind)
                cv2.imwrite(os.path.join(self.folder, names[kind]), image)

            save("before", before)
            save("after", after)
            parts = [("before", before), ("after", after)] + ([("truth", truth)] if truth is not None else [])
            save("comparison", np.hstack([label(image, text) for text, image in parts]))
            size = (before.shape[1] // 5, before.shape[0] // 5)
            rows = []
            for x, y in crop_windows(to_grey(after), mask, 3, size):
                cells = [image[y:y + size[1], x:x + size[0]] for _, image in parts]
                cells = [cv2.resize(c, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC) for c in cells]
                rows.append(np.hstack([label(c, text) for c, (text, _) in zip(cells, parts)]))
            if rows:
                save("crops", np.vstack(rows))
            if overlay is not None:
                save("overlay", overlay)
            files.append(names)
        return files


def plot(rows, path):
    index = [r["frame"] for r in rows]
    curves = [("median blur extent [px]", [("predicted", "median_extent_px")])]
    if any(r.get("psnr_before_db") is not None for r in rows):
        curves.append(("PSNR against the sharp truth [dB]",
                       [("before", "psnr_before_db"), ("after", "psnr_after_db")]))
        curves.append(("SIFT matches with the sharp truth, correct",
                       [("before", "truth_matches_before"), ("after", "truth_matches_after")]))
    curves.append(("SIFT keypoints", [("before", "keypoints_before"), ("after", "keypoints_after")]))
    curves.append(("SIFT matches with the frame before, inliers",
                   [("before", "consecutive_matches_before"), ("after", "consecutive_matches_after")]))
    figure, axes = plt.subplots(len(curves), 1, figsize=(9, 2.4 * len(curves)), sharex=True)
    for axis, (title, series) in zip(np.atleast_1d(axes), curves):
        for name, key in series:
            axis.plot(index, [np.nan if r.get(key) is None else r[key] for r in rows], marker=".", label=name)
        axis.set_ylabel(title, fontsize=7)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    np.atleast_1d(axes)[-1].set_xlabel("frame")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
