"""Places of one image recognised in another without any idea of where the camera is: ORB features."""

import cv2
import numpy as np

from server.vision.contracts import Array, Image

FEATURES = 1200
RATIO_MAX = 0.85  # of the best distance to the second best


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
