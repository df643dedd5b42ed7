"""Masks that commissioning finds, and how they come into the settings file."""

import numpy as np
import pytest
from commissioning_states import MACHINE, StandInOperator, site

from server.camera.own_structure import uncovered_frac
from server.commissioning.camera_axes import masks_wanted, propose_masks
from server.settings import read_settings
from server.settings_source import source_and_machine
from server.shell_settings import vision_settings

SHAPE = (MACHINE.camera.height_px, MACHINE.camera.width_px)
SETTINGS = """# the crane at the gate
mode = "REAL"

[camera]  # a ZED
kind = "device"
mask_left = [[[0, 0], [10, 0], [10, 10]]]
rate_hz = 30.0

[plc]
host = "10.0.0.5"
"""


def still(*boxes):
    mask = np.zeros(SHAPE, np.uint8)
    for u, v, width, height in boxes:
        mask[v : v + height, u : u + width] = 255
    return mask


BOOM, CHANCE = (0, 400, 320, 320), (900, 0, 160, 160)
LEGS = [(still(BOOM, CHANCE), still(BOOM)), (None, None), (still(BOOM), still(BOOM, CHANCE))]


def masks_in(file):
    settings = read_settings(file)
    source, machine = source_and_machine(settings.camera, MACHINE)
    found = vision_settings(source, settings.camera, machine.camera)
    return settings, (found.mask_left, found.mask_right)


async def test_masks_of_both_eyes_are_written_beside_what_the_settings_hold(tmp_path):
    file = tmp_path / "site.toml"
    file.write_text(SETTINGS, encoding="utf-8")
    _, masks = masks_in(file)
    note = await propose_masks(site(settings_file=file), LEGS, masks)
    assert f"masks over it are in {file} now" in note
    settings, masks = masks_in(file)
    assert (settings.mode, settings.camera.rate_hz, settings.plc.host) == ("REAL", 30.0, "10.0.0.5")
    assert file.read_text(encoding="utf-8").startswith("# the crane at the gate\n")
    for polygons in masks:
        assert uncovered_frac(still(BOOM), polygons) < 0.002
        assert uncovered_frac(still(CHANCE), polygons) > 0.02, "in one leg only: chance"
    assert uncovered_frac(still((2, 1, 6, 2)), masks[0]) == 0.0, "what was masked before"
    assert "put into" not in await propose_masks(site(settings_file=file), LEGS, masks)


@pytest.mark.parametrize("text", ["", "[plc]\nport = 50110\n"])
async def test_a_file_without_a_camera_gets_one(tmp_path, text):
    file = tmp_path / "site.toml"
    file.write_text(text, encoding="utf-8")
    await propose_masks(site(settings_file=file), LEGS, ((), ()))
    settings, masks = masks_in(file)
    assert settings.camera.kind == "http"
    assert all(masks)


async def test_nothing_is_written_without_leave_or_where_the_file_is_written_another_way(tmp_path):
    file = tmp_path / "site.toml"
    for text, operator in (
        (SETTINGS, StandInOperator(confirms=False)),
        (SETTINGS.replace("mask_left = [[", "mask_left = [\n[").replace("]]]", "]\n]]"), StandInOperator()),
        ('camera = { kind = "http" }\n', StandInOperator()),
    ):
        file.write_text(text, encoding="utf-8")
        note = await propose_masks(site(operator=operator, settings_file=file), LEGS, ((), ()))
        assert "put into [camera] of the settings: mask_left = [[[" in note
        assert file.read_text(encoding="utf-8") == text
    assert "no leg moved" in await propose_masks(site(settings_file=file), [(None, still(BOOM))], ((), ()))
    assert masks_wanted([], ((), ())) is None
