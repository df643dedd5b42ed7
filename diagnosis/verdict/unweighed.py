"""Where nobody says what the links weigh: what bends under its weight, and the encoder's error that it is told as."""

from collections.abc import Sequence

import numpy as np

from diagnosis.log.nominal import Nominal
from diagnosis.verdict.weigh import Key

SAG = "gravity_sag"
SEEN_AS = ("encoder_scale", "encoder_eccentricity")  # a torque that goes with the sine of the joint's own angle
BESIDE = "encoder_bias"  # the mean of such a torque; alone it is a zero that is off
LEVEL_MIN = 0.1  # sine between an axis and the upright: below it nothing that hangs on the joint turns it


def unweighed(nominal: Nominal | None, names: Sequence[Key]) -> list[tuple[Key, Key]]:
    """Names that a sag of the same joint may stand behind, each with that sag; none where masses are known.

    Why: without masses a sag is not in the library, and of an industrial robot it is the likelier of the two.
    """
    if nominal is None or nominal.arm is None or float(nominal.arm.mass.sum()) > 0.0:
        return []
    arm = nominal.arm
    first = arm.before[0, :3, :3] @ np.array([0.0, 0.0, 1.0])
    upright = arm.gravity / max(float(np.linalg.norm(arm.gravity)), 1e-9)
    level = float(np.linalg.norm(np.cross(first, upright))) > LEVEL_MIN
    carrying = range(1 if level else 2, nominal.n + 1)
    bent = {joint for name, joint in names if name in SEEN_AS and joint in carrying}
    seen = (*SEEN_AS, BESIDE)
    return [((name, joint), (SAG, joint)) for name, joint in names if name in seen and joint in bent]
