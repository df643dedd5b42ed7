"""Masks over the machine itself: read from the settings, proposed from what stands still while the camera moves."""

import cv2
import numpy as np
import pytest

from server.camera.check_findings import Level
from server.camera.contracts import StereoFrame, VisionSettings
from server.camera.own_structure import check_own_structure, mask_line, mask_polygons, still_mask
from server.camera.pipeline import VisionPipeline
from server.camera.sources.settings import HttpSource
from server.errors import SettingsError
from server.settings import read_machine, read_settings
from server.settings_source import source_and_machine
from server.shell_settings import vision_settings
from server.vision.contracts import ObjectPose, OdometryPose, OdometryStatus, PairObservation, PoseStatus

MACHINE = read_machine("hiab033")
HEIGHT, WIDTH = MACHINE.camera.height_px, MACHINE.camera.width_px


def texture(seed, height=HEIGHT, width=WIDTH + 400):
    rough = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32), (0, 0), 2.5)
    return 128 + 30 * rough / rough.std()


def pictures(n=8, step_px=23, beam=True, seed=1):
    """One eye: a wall that shifts, and a beam with a plain middle at the lower left that does not."""
    rng, wall, own, out = np.random.default_rng(seed), texture(seed), texture(seed + 1), []
    for k in range(n):
        picture = wall[:, k * step_px : k * step_px + WIDTH].copy()
        if beam:
            picture[400:, :320] = own[400:, :320]
            picture[500:540, 100:140] = 90.0
        out.append(np.clip(picture + rng.normal(0.0, 2.0, picture.shape), 0, 255).astype(np.uint8))
    return out


def test_what_stands_still_while_the_camera_moves_is_proposed():
    mask = still_mask(pictures())
    assert mask is not None
    own = np.zeros_like(mask)
    own[400:, :320] = 255
    assert (mask[own > 0] > 0).mean() > 0.98, "the plain middle too"
    assert (mask[own == 0] > 0).mean() < 0.03, "a border of blocks"
    without = still_mask(pictures(beam=False))
    assert without is not None
    assert not without.any()
    assert still_mask(pictures(step_px=0)) is None, "a camera at rest says nothing"
    assert still_mask(pictures(n=3)) is None


def test_the_proposal_is_what_the_settings_read(tmp_path):
    left, right = pictures(), pictures(seed=5)
    pairs = list(zip(left, right, strict=True))
    found = check_own_structure(pairs)
    assert found.level is Level.WARN
    lines = [mask_line("left", still_mask(left)), mask_line("right", still_mask(right))]
    assert all(line in found.remedy for line in lines)
    assert found.figures["left_unmasked_frac"] > 0.1
    file = tmp_path / "s.toml"
    file.write_text('[camera]\nkind = "http"\n' + "\n".join(lines) + "\n", encoding="utf-8")
    settings = read_settings(file)
    source, machine = source_and_machine(settings.camera, MACHINE)
    vision = vision_settings(source, settings.camera, machine.camera)
    again = check_own_structure(pairs, (vision.mask_left, vision.mask_right))
    assert again.level is Level.OK
    assert again.figures["left_unmasked_frac"] < 0.005


def test_a_picture_serves_as_a_mask(tmp_path):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[500:, 300:700] = 255
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), mask)
    polygons = mask_polygons(str(path), MACHINE.camera, "mask_left")
    drawn = np.zeros_like(mask)
    for polygon in polygons:
        cv2.fillPoly(drawn, [polygon.astype(np.int32)], 255)
    assert np.abs(drawn.astype(int) - mask).mean() < 1.0
    cv2.imwrite(str(path), mask[::2, ::2])
    with pytest.raises(SettingsError, match=r"640 x 360 px, an eye's picture 1280 x 720"):
        mask_polygons(str(path), MACHINE.camera, "mask_left")
    path.write_bytes(b"none")
    with pytest.raises(SettingsError, match="is not a picture"):
        mask_polygons(str(path), MACHINE.camera, "mask_left")
    with pytest.raises(SettingsError, match="No such file"):
        mask_polygons(str(tmp_path / "no.png"), MACHINE.camera, "mask_left")


class NoMarkers:
    def observe(self, left, right, t_exposure_ns):
        unseen = [ObjectPose(name, PoseStatus.NOT_SEEN, "", None, None, (), 0.0, 0.0) for name in ("tool", "ooi")]
        return PairObservation(t_exposure_ns, *unseen, (), ())


class NoOdometry:
    def process(self, left, right, t_exposure_ns, mask_polygons_left=(), mask_polygons_right=()):
        return OdometryPose(t_exposure_ns, np.eye(4), np.eye(6), OdometryStatus.OK, "", 100)

    def map_points(self, count_max):
        return np.zeros((0, 3))


@pytest.mark.parametrize("asked", [True, False])
def test_a_run_of_odometry_says_what_stood_still_in_each_eye_where_asked(asked):
    sources = {"stereo": NoMarkers(), "mono": NoMarkers()}
    pipeline = VisionPipeline(VisionSettings(HttpSource("http://x/")), [], sources, NoOdometry)
    eyes = pictures(n=16, step_px=20), pictures(n=16, step_px=20, seed=5, beam=False)
    pipeline.switch_odometry(True, 3, masks=asked)
    for k, (left, right) in enumerate(zip(*eyes, strict=True)):
        pipeline.process(StereoFrame(left, right, k * 66_000_000, k * 66_000_000 + 1, k), 0)
    ended = pipeline.switch_odometry(False)
    pipeline.close()
    assert ended is not None
    if not asked:
        assert ended.still_masks == (None, None)
        return
    left, right = ended.still_masks
    assert left is not None
    assert right is not None
    assert (left > 0)[400:, :320].mean() > 0.98
    assert not right.any()
