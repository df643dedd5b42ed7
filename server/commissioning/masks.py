"""Masks over the machine itself: what stood still in both eyes' pictures while the tool moved, into the settings."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recording.files import read_text, write_durably
from server.camera.own_structure import UNMASKED_MIN_FRAC, Masks, drawn, mask_line, uncovered_frac
from server.commissioning.site import Site
from server.vision.contracts import Image

EYES = ("left", "right")
Still = tuple[Image | None, Image | None]


async def propose_masks(site: Site, seen: Sequence[Still], masks: Masks) -> str:
    """What the step's report says of the masks; written into the settings file where there is one and leave is given.

    Args:    seen: of each leg, what stood still in the left and the right eye. masks: of the settings.
    """
    wanted = masks_wanted(seen, masks)
    if wanted is None:
        return "no leg moved both images enough to detect the machine's own structure"
    shares = [100.0 * uncovered_frac(mask, polygons) for mask, polygons in zip(wanted, masks, strict=True)]
    found = f"{shares[0]:.0f} % of the left and {shares[1]:.0f} % of the right picture move with the camera unmasked"
    if max(shares) < 100.0 * UNMASKED_MIN_FRAC:
        return found
    lines = {f"mask_{eye}": mask_line(eye, mask) for eye, mask in zip(EYES, wanted, strict=True)}
    by_hand = f"{found}; put into [camera] of the settings: {' '.join(lines.values())}"
    file = site.options.settings_file
    if file is None or not await site.operator.confirm(f"{found}: masks over it will be written into {file}"):
        return by_hand
    if not _written(file, lines, site.settings.camera.kind):
        return by_hand
    return f"{found}; masks over it are in {file} now, for the next start of the server"


def masks_wanted(seen: Sequence[Still], masks: Masks) -> tuple[Image, Image] | None:
    """Masks (h, w), 255 over what stood still in every leg that moved the picture, and over what is masked already.

    Returns: None where no leg moved an eye's picture.
    """
    found: list[Image] = []
    for eye, polygons in enumerate(masks):
        told = [mask for still in seen if (mask := still[eye]) is not None]
        if not told:
            return None
        found.append(np.asarray(np.minimum.reduce(told) | drawn(told[0].shape, polygons), np.uint8))
    return found[0], found[1]


def _written(file: Path, lines: dict[str, str], kind: str) -> bool:
    """Whether the lines are in the file's [camera] now, and nothing else in it has changed."""
    try:
        before = read_text(file)
        after = with_camera_lines(before, lines, kind)
        expected = tomllib.loads(before)
        expected.setdefault("camera", {"kind": kind}).update(tomllib.loads("\n".join(lines.values())))
        if tomllib.loads(after) != expected:
            return False
        write_durably(file, after)
    except (OSError, tomllib.TOMLDecodeError):
        return False
    return True


def with_camera_lines(text: str, lines: dict[str, str], kind: str) -> str:
    """A settings file's text with these lines, by their key, at the top of its [camera] in place of those it had."""
    for key in lines:
        text = re.sub(rf"(?m)^[ \t]*{key}[ \t]*=.*\n?", "", text)
    new = "\n".join(lines.values())
    header = re.search(r"(?m)^[ \t]*\[camera\][^\n]*$", text)
    if header is None:
        return f'{text.rstrip()}\n\n[camera]\nkind = "{kind}"\n{new}\n'.lstrip()
    return f"{text[: header.end()]}\n{new}{text[header.end() :]}"
