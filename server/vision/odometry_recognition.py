"""Places of one image recognised in another without any idea of where the camera is, and an image in itself."""

import cv2
import numpy as np

from server.vision.contracts import Array, Image

FEATURES = 1200
RATIO_MAX = 0.85  # of the best distance to the second best
SCALE = 0.5  # at which a picture is compared with itself
LOBE_PX = 4  # at that scale: nearer, a picture resembles itself whatever it shows
ALIKE_FRAC = 0.8  # of the strongest repetition: its neighbours on the same lattice
REPEATS_MAX = 4  # nearest repetitions
UNIQUE_RATIO_MAX = 0.8  # of the best dissimilarity to the second best: below, the best is unique (Lowe 2004)


def recognise(first: Image, mask_first: Image, second: Image, mask_second: Image) -> tuple[Array, Array]:
    """Places (n, 2) [px] of the first image and where they seem to be in the second; many may be wrong.

    Source:  Rublee et al. 2011 (ORB); ratio test of Lowe 2004.
    """
    none = np.zeros((0, 2))
    orb = cv2.ORB.create(nfeatures=FEATURES, fastThreshold=10)
    places, descriptors = [], []
    for image, mask in ((first, mask_first), (second, mask_second)):
        points, found = orb.detectAndCompute(image, mask)
        if found is None or len(points) < 2:
            return none, none
        places.append(np.array([point.pt for point in points], dtype=np.float64))
        descriptors.append(found)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    good = [
        (pair[0].queryIdx, pair[0].trainIdx)
        for pair in matcher.knnMatch(descriptors[0], descriptors[1], k=2)
        if len(pair) == 2 and pair[0].distance < RATIO_MAX * pair[1].distance
    ]
    chosen = np.array(good, dtype=np.int64).reshape(-1, 2)
    return places[0][chosen[:, 0]], places[1][chosen[:, 1]]


def repeats(image: Image, along_rows: bool = False) -> Array:
    """Ways (k, 2) [px] by which a picture may repeat itself, the nearest first; few or none where it does not.

    Model:   normalised correlation of its middle half, each way, with the whole: local maxima besides the main one.
    """
    small = cv2.resize(image, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_AREA)
    top, left = small.shape[0] // 4, small.shape[1] // 4
    middle = small[top : small.shape[0] - top, left : small.shape[1] - left]
    if along_rows:
        small, top = small[top : small.shape[0] - top], 0
    likeness = np.asarray(cv2.matchTemplate(small, middle, cv2.TM_CCOEFF_NORMED))
    peaks = likeness >= np.asarray(cv2.dilate(likeness, np.ones((2 * LOBE_PX + 1,) * 2, np.uint8)))
    ways = np.argwhere(peaks & (likeness > 0.0))[:, ::-1] - [left, top]
    heights = likeness[ways[:, 1] + top, ways[:, 0] + left]
    apart = np.linalg.norm(ways, axis=1)
    ways, heights = ways[apart > LOBE_PX], heights[apart > LOBE_PX]
    ways = ways[heights >= ALIKE_FRAC * heights.max(initial=0.0)]
    return np.asarray(ways[np.argsort(np.linalg.norm(ways, axis=1))][:REPEATS_MAX] / SCALE, dtype=np.float64)
