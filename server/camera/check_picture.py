"""Sharpness and exposure of both eyes. Pure: pictures in, findings out."""

from collections.abc import Sequence

import cv2
import numpy as np

from server.camera.check_findings import CheckFinding, Level, level_by_limits
from server.vision.contracts import Image

EYE_NAMES = ("left", "right")
REBLUR_SIGMA_PX = 1.5
SMOOTHING_SIGMA_PX = 0.7
FILTER_BLUR_VARIANCE_PX2 = (
    SMOOTHING_SIGMA_PX**2 + 1.0 / 3.0
)  # and a difference over two pixels is a mean over two pixels
EDGE_PIXELS_FRAC = 0.005  # the steepest of the pixels
EDGE_SLOPE_MIN_GREY = 6.0  # per pixel; flatter pictures have no edges to measure by
BLUR_PERCENTILE = 20.0  # of the edges: depth of field and soft shadows blur others
BLUR_WARN_PX, BLUR_FAIL_PX = 1.6, 2.6
DARK_GREY, WHITE_GREY = 16, 250
DARK_WARN_FRAC, DARK_FAIL_FRAC = 0.35, 0.8
WHITE_WARN_FRAC, WHITE_FAIL_FRAC = 0.05, 0.3
UNEQUAL_WARN_FRAC, UNEQUAL_FAIL_FRAC = 0.25, 0.6  # difference of the eyes' means, of their mean


def edge_blur_px(image: Image) -> float:
    """Standard deviation of the blur at the sharpest edges [px]; NaN where there are none.

    Model:   an edge of blur s is blurred again by b: its slope falls by R = sqrt(s^2 + b^2) / s; s = b / sqrt(R^2 - 1).
    Args:    image: grey (h, w).
    Source:  Zhuo and Sim 2011, Defocus map estimation from a single image, equations 3 to 5.
    """
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), SMOOTHING_SIGMA_PX)  # against noise
    blurred = cv2.GaussianBlur(smooth, (0, 0), REBLUR_SIGMA_PX)
    slope, softer = (
        np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)) / 8.0
        for grey in (smooth, blurred)
    )
    limit = max(float(np.quantile(slope, 1.0 - EDGE_PIXELS_FRAC)), EDGE_SLOPE_MIN_GREY)
    ridge = (slope >= limit) & (slope >= cv2.dilate(slope, np.ones((3, 3), np.uint8)))
    if ridge.sum() < 20:
        return float("nan")
    ratio = slope[ridge] / np.maximum(softer[ridge], 1e-3)
    found = REBLUR_SIGMA_PX / np.sqrt(np.maximum(ratio**2 - 1.0, 1e-3))
    return float(np.sqrt(max(np.percentile(found, BLUR_PERCENTILE) ** 2 - FILTER_BLUR_VARIANCE_PX2, 0.0)))


def check_sharpness(pairs: Sequence[tuple[Image, Image]]) -> CheckFinding:
    """Finding `sharpness`: the blurrier eye's median over the pairs."""
    blurs = [[edge_blur_px(image) for image in eye] for eye in zip(*pairs, strict=True)]
    known = [np.array(blur)[np.isfinite(blur)] for blur in blurs]
    if any(len(blur) == 0 for blur in known):
        return CheckFinding(
            "sharpness", Level.WARN, "inconclusive: no edge in view", "point it at something with edges, and light it"
        )
    medians = [float(np.median(blur)) for blur in known]
    level = level_by_limits(max(medians), BLUR_WARN_PX, BLUR_FAIL_PX)
    text = f"blur {medians[0]:.1f} px in the left eye, {medians[1]:.1f} px in the right (limit {BLUR_WARN_PX:g})"
    worse = EYE_NAMES[int(np.argmax(medians))]
    remedy = "" if level is Level.OK else f"focus or clean the {worse} lens, hold still, shorten the exposure"
    return CheckFinding("sharpness", level, text, remedy, {"blur_left_px": medians[0], "blur_right_px": medians[1]})


def check_exposure(pairs: Sequence[tuple[Image, Image]]) -> CheckFinding:
    """Finding `exposure`: dark and saturated shares, and how equal the eyes are."""
    figures: dict[str, float] = {}
    for name, eye in zip(EYE_NAMES, zip(*pairs, strict=True), strict=True):
        grey = np.stack([image[::4, ::4] for image in eye])
        figures |= {
            f"dark_{name}_frac": float((grey < DARK_GREY).mean()),
            f"white_{name}_frac": float((grey >= WHITE_GREY).mean()),
            f"mean_{name}_grey": float(grey.mean()),
        }
    dark = max(figures["dark_left_frac"], figures["dark_right_frac"])
    white = max(figures["white_left_frac"], figures["white_right_frac"])
    means = figures["mean_left_grey"], figures["mean_right_grey"]
    unequal = abs(means[0] - means[1]) / max(0.5 * sum(means), 1.0)
    shares = f"of the worse eye {100 * dark:.0f} % dark, {100 * white:.0f} % saturated"
    text = f"mean grey {means[0]:.0f} left, {means[1]:.0f} right; {shares}"
    ranked = (
        (level_by_limits(dark, DARK_WARN_FRAC, DARK_FAIL_FRAC), "lens cap off? longer exposure or more light"),
        (level_by_limits(white, WHITE_WARN_FRAC, WHITE_FAIL_FRAC), "shorter exposure, or shade the lamp or the sun"),
        (
            level_by_limits(unequal, UNEQUAL_WARN_FRAC, UNEQUAL_FAIL_FRAC),
            "clean the darker lens; give both eyes one exposure and gain",
        ),
    )
    for wanted in (Level.FAIL, Level.WARN):
        for level, remedy in ranked:
            if level is wanted:
                return CheckFinding("exposure", level, text, remedy, figures)
    return CheckFinding("exposure", Level.OK, text, "", figures)
