"""Black, white and empty pictures: the whole of them, most of them, or one eye alone."""

import numpy as np

from server.camera.health.findings import FaultCode, Finding
from server.camera.health.pair import Pair
from server.camera.health.thumbnail import MEAN, STD, WHITE, EyeCells

BLACK_GREY = 16.0  # a cell no brighter than this ...
BLACK_STD_GREY = 4.0  # ... and without structure is black; video black is 16
BLACK_FRAC = 0.5
WHITE_FRAC = 0.5
FLAT_STD_GREY = 2.0  # spread of all cells and within them: less is one plain surface
FLAT_RATIO = 0.2  # the spread of one eye against the other's


class ExposureMonitor:
    """Looks at one pair only: nothing to remember."""

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Black, saturated or without contrast."""
        black = [_black_frac(eye) for _, eye in pair.eyes]
        if min(black) > BLACK_FRAC:
            return (_both_black(min(black)),)
        if max(black) > BLACK_FRAC:
            return (_one_black("left" if black[0] > BLACK_FRAC else "right", max(black)),)
        white = [float(eye.field(WHITE).mean()) for _, eye in pair.eyes]
        if max(white) > WHITE_FRAC:
            return (_white("left" if white[0] >= white[1] else "right", white),)
        return _flat(pair)


def _black_frac(eye: EyeCells) -> float:
    return float(np.mean((eye.field(MEAN) < BLACK_GREY) & (eye.field(STD) < BLACK_STD_GREY)))


def _both_black(share: float) -> Finding:
    extent = "both eyes are black" if share > 0.95 else f"{100 * share:.0f} % of both eyes is black"
    limit = f"(limit {100 * BLACK_FRAC:.0f} %)"
    return Finding(FaultCode.BLACK, f"{extent} {limit}; check exposure, lens cap and light")


def _one_black(eye: str, share: float) -> Finding:
    extent = f"the {eye} eye is black" if share > 0.95 else f"{100 * share:.0f} % of the {eye} eye is black"
    return Finding(FaultCode.EYE_GONE, f"{extent} (limit {100 * BLACK_FRAC:.0f} %); check its lens and cable")


def _white(eye: str, white: list[float]) -> Finding:
    name = "both eyes are" if min(white) > WHITE_FRAC else f"the {eye} eye is"
    share = f"{100 * max(white):.0f} % of its pixels (limit {100 * WHITE_FRAC:.0f} %)"
    return Finding(FaultCode.SATURATED, f"{name} saturated: {share}; lower the exposure or shade the lamp")


def _flat(pair: Pair) -> tuple[Finding, ...]:
    spread = [eye.spread_grey for _, eye in pair.eyes]
    if max(spread) < FLAT_STD_GREY:
        text = (
            f"no contrast in either eye: {max(spread):.1f} grey levels (limit {FLAT_STD_GREY:g}); check lenses, fog "
            "and light"
        )
        return (Finding(FaultCode.NO_CONTRAST, text),)
    low = min(spread)
    if low < FLAT_STD_GREY and low < FLAT_RATIO * max(spread):
        eye = "left" if spread[0] < spread[1] else "right"
        text = (
            f"the {eye} eye shows nothing: contrast {low:.1f} grey levels (limit {FLAT_STD_GREY:g}), the other eye "
            f"{max(spread):.1f}; check its lens and cable"
        )
        return (Finding(FaultCode.EYE_GONE, text),)
    return ()
