"""`longreach target`: prints of the right size, and a layout taught from a folder of pictures."""

import json
import re
import tomllib
import xml.etree.ElementTree as ET
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner
from vision_prints import photographed, printed
from vision_scenes import ROOT, deviation, machine
from vision_teaching import ways

from longreach.target_command import app
from machine.boards import board_markers
from machine.description import Board, Marker, parse_machine_toml
from machine.rotations import rotation_from_rotvec
from server.camera.contracts import StereoFrame
from server.camera.target_pictures import MarkerSearch, TargetError, live_views, read_pair, stored_pairs
from server.vision.marker_search import dictionary_by_name, find_markers
from server.vision.target_page import (
    PAPER_SIZES_MM,
    POINTS_PER_MM,
    board_page,
    marker_page,
    pdf_of,
    png_of,
    raster_of,
    svg_of,
)
from server.vision.teach_contracts import TeachSettings
from server.vision.teach_views import OfferedView

NAME = "DICT_APRILTAG_36h11"
DICTIONARY = dictionary_by_name(NAME)
MARKER = Marker(17, 0.12, "ooi", np.eye(4))
BOARD = Board("charuco", "ooi", 5, 4, 0.04, 0.03, 3, False, np.eye(4))
RUNNER = CliRunner()


def squares_of(pixels, page):
    """An SVG's or PDF's filled rectangles as a picture of 10 px a mm."""
    image = np.full((round(page.height_mm * 10), round(page.width_mm * 10)), 255, np.uint8)
    for x, y, width, height in pixels:
        image[round(y * 10) : round((y + height) * 10), round(x * 10) : round((x + width) * 10)] = 0
    return image


def svg_picture(content, page):
    root = ET.fromstring(content)
    assert root.get("width") == f"{page.width_mm:g}mm"
    number = r"(-?[0-9.e-]+)"
    pattern = re.compile(rf"M{number} {number}h{number}v{number}h")
    rectangles = [
        match for path in root.iter("{http://www.w3.org/2000/svg}path") for match in pattern.findall(path.get("d"))
    ]
    return squares_of([[float(value) for value in one] for one in rectangles], page)


def pdf_picture(content, page):
    k = POINTS_PER_MM
    found = re.findall(rb"([0-9.-]+) ([0-9.-]+) ([0-9.-]+) ([0-9.-]+) re", content)
    rectangles = [[float(value) / k for value in one] for one in found]
    return squares_of([(x, page.height_mm - y - height, width, height) for x, y, width, height in rectangles], page)


@pytest.mark.parametrize("how", ["png", "svg", "pdf"])
def test_a_printed_marker_has_its_side_and_its_ruler_100_mm(how):
    page = marker_page(NAME, DICTIONARY, MARKER, None)
    assert (page.width_mm, page.height_mm) == PAPER_SIZES_MM["a4"]
    if how == "png":
        image, per_mm = raster_of(page, 300), 300 / 25.4
    else:
        image = svg_picture(svg_of(page), page) if how == "svg" else pdf_picture(pdf_of([page]), page)
        per_mm = 10.0
    (found,) = find_markers(image, DICTIONARY)
    assert found.marker_id == 17
    sides = np.linalg.norm(found.corners_px - np.roll(found.corners_px, -1, axis=0), axis=1) / per_mm
    assert sides == pytest.approx(120.0, abs=0.25)
    assert found.corners_px[0, 1] < found.corners_px[3, 1], "upright"
    rows = image[-round(20 * per_mm) :]
    columns = np.flatnonzero((rows < 128).sum(axis=0) >= 4 * per_mm)  # the long ticks at 0, 50 and 100 mm
    assert (columns[-1] - columns[0]) / per_mm == pytest.approx(100.0, abs=0.5)


def test_pdf_tells_its_size_and_its_table_is_right():
    pages = [marker_page(NAME, DICTIONARY, MARKER, "a3"), board_page(NAME, DICTIONARY, BOARD, None)]
    content = pdf_of(pages)
    assert content.startswith(b"%PDF-1.4")
    assert f"/MediaBox [0 0 {297 * POINTS_PER_MM:.3f} {420 * POINTS_PER_MM:.3f}]".encode() in content
    assert b"/PrintScaling /None" in content
    start = int(re.search(rb"startxref\n(\d+)", content)[1])
    places = [int(one) for one in re.findall(rb"(\d{10}) 00000 n", content[start:])]
    assert len(places) == 7
    for number, place in enumerate(places, 1):
        assert content[place:].startswith(b"%d 0 obj" % number)
    for length, stream in re.findall(rb"/Length (\d+) >>\nstream\n(.*?)\nendstream", content, re.DOTALL):
        assert int(length) == len(stream)


def test_png_carries_its_resolution():
    content = png_of(marker_page(NAME, DICTIONARY, MARKER, None), 200)
    place = content.index(b"pHYs")
    assert int.from_bytes(content[place + 4 : place + 8]) == round(200 / 0.0254)
    assert int.from_bytes(content[place + 13 : place + 17]) == zlib.crc32(content[place : place + 13])
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (2339, 1654)


@pytest.mark.parametrize("kind", ["charuco", "grid"])
def test_a_printed_board_has_its_markers_in_place(kind):
    board = replace(BOARD, kind=kind)
    page = board_page(NAME, DICTIONARY, board, None)
    image = svg_picture(svg_of(page), page)
    found = {one.marker_id: one.corners_px for one in find_markers(image, DICTIONARY)}
    middle = np.array([page.width_mm, page.height_mm - 34.0]) / 2
    assert len(found) == len(board_markers(board))
    for marker in board_markers(board):
        x, y = 1e3 * marker.T_on_marker[:2, 3]
        assert found[marker.marker_id].mean(axis=0) / 10.0 == pytest.approx(middle + np.array([x, -y]), abs=0.2)


def test_what_does_not_fit_on_the_paper_is_refused():
    with pytest.raises(ValueError, match="marker 17 needs 150 x 150 mm with its white, more than a5"):
        marker_page(NAME, DICTIONARY, MARKER, "a5")
    result = RUNNER.invoke(app, ["print", "unused", "--paper", "a5"])
    assert isinstance(result.exception, TargetError)


def test_print_writes_every_marker_of_the_machine(tmp_path):
    assert RUNNER.invoke(app, ["print", str(tmp_path / "svg"), "--format", "svg"]).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "svg").iterdir()) == [f"marker_{k}.svg" for k in (1, 10, 2, 3)]
    assert RUNNER.invoke(app, ["print", str(tmp_path / "pdf"), "--on", "ooi"]).exit_code == 0
    assert b"/Count 3 " in (tmp_path / "pdf" / "targets.pdf").read_bytes()
    for wrong in (["--format", "gif"], ["--on", "wall"], ["--paper", "a9"]):
        assert isinstance(RUNNER.invoke(app, ["print", str(tmp_path), *wrong]).exception, TargetError)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Pictures of the shipped machine's OOI, its markers some mm and deg off the file, and the truth."""
    rng, folder = np.random.default_rng(21), tmp_path_factory.mktemp("pairs")
    markers = []
    for marker in machine().markers_on("ooi"):
        T = marker.T_on_marker.copy()
        T[:3, 3] += rng.normal(0.0, 0.004, 3)
        T[:3, :3] = rotation_from_rotvec(rng.normal(0.0, 0.02, 3)) @ T[:3, :3]
        markers.append(replace(marker, T_on_marker=T))
    boards = printed("DICT_4X4_50", *markers)
    for eye in ("left", "right"):
        (folder / eye).mkdir()
    for k, T in enumerate(ways(rng, n=7)):
        for eye, image in zip(("left", "right"), photographed(boards, T, rng), strict=True):
            cv2.imwrite(str(folder / eye / f"{k:03}.png"), image)
    return folder, markers


def test_teach_from_a_folder_gives_lines_for_the_machine_file(scene, tmp_path):
    folder, markers = scene
    out = tmp_path / "new" / "layout"
    result = RUNNER.invoke(app, ["teach", "--folder", str(folder), "--frame", "reference", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "Known to +-" in result.output
    text = (ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    first, end = text.index("# The OOI's three markers"), text.index("[plc]")
    fragment = out.with_suffix(".toml").read_text(encoding="utf-8")
    taught = parse_machine_toml(text[:first] + fragment + text[end:])
    assert len(tomllib.loads(fragment)["markers"]["marker"]) == 3
    saved = json.loads(out.with_suffix(".json").read_text(encoding="utf-8"))
    assert saved["status"] == "ok"
    assert np.array(saved["markers"][1]["covariance"]).shape == (6, 6)
    shift = machine().markers_on("ooi")[0].T_on_marker @ np.linalg.inv(markers[0].T_on_marker)
    for one, marker in zip(taught.markers_on("ooi"), markers, strict=True):
        apart = deviation(one.T_on_marker, shift @ marker.T_on_marker)
        assert 1e3 * np.linalg.norm(apart[3:]) < 0.3
        assert np.rad2deg(np.linalg.norm(apart[:3])) < 0.1


def test_teach_shows_the_lines_where_no_file_is_wanted(scene):
    result = RUNNER.invoke(app, ["teach", "--folder", str(scene[0]), "--ids", "2,1", "--side-mm", "2=150"])
    assert result.exit_code == 0, result.output
    assert "[[markers.marker]]" in result.output
    assert result.output.index("id = 2") < result.output.index("id = 1\n")


def test_teach_refuses_one_view_and_says_why(scene, tmp_path):
    folder = tmp_path / "one"
    for eye in ("left", "right"):
        (folder / eye).mkdir(parents=True)
        (folder / eye / "0.png").write_bytes((scene[0] / eye / "000.png").read_bytes())
    result = RUNNER.invoke(app, ["teach", "--folder", str(folder), "--out", str(tmp_path / "x")])
    assert result.exit_code == 1
    assert "no layout (too_few_views)" in result.output
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["markers"] == []
    assert not (tmp_path / "x.toml").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--on", "wall"], "give tool or ooi"),
        (["--ids", "1,x"], "give whole numbers"),
        (["--ids", "1,50"], "50 is not in DICT_4X4_50, whose last id is 49"),
        (["--side-mm", "wide"], "give 150, or"),
        (["--side-mm", "1=4000"], "between 5 and 2000"),
        (["--frame", "base"], "give present, reference or middle"),
    ],
)
def test_teach_refuses_wrong_options(scene, options, words):
    result = RUNNER.invoke(app, ["teach", "--folder", str(scene[0]), *options])
    assert isinstance(result.exception, TargetError)
    assert words in str(result.exception)


def test_stored_pairs_in_several_forms(tmp_path):
    image = np.zeros((4, 8), np.uint8)

    def write(*names):
        for name in names:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(tmp_path / name), image)

    with pytest.raises(TargetError, match="no stereo pairs"):
        stored_pairs(tmp_path)
    write("both/1.png", "both/2.png")
    assert [right for _, right in stored_pairs(tmp_path / "both")] == [None, None]
    assert read_pair(tmp_path / "both" / "1.png", None)[1].shape == (4, 4)
    write("named/a_left.png", "named/a_right.png")
    assert stored_pairs(tmp_path / "named")[0][1].name == "a_right.png"
    write("named/b_left.png")
    with pytest.raises(TargetError, match=r"b_right\.png is missing"):
        stored_pairs(tmp_path / "named")
    write(
        "euroc/cam0/data/1.png", "euroc/cam1/data/1.png", "uneven/left/1.png", "uneven/left/2.png", "uneven/right/1.png"
    )
    assert len(stored_pairs(tmp_path / "euroc")) == 1
    with pytest.raises(TargetError, match="2 left files in left and 1 right files in right"):
        stored_pairs(tmp_path / "uneven")
    (tmp_path / "both" / "3.png").write_bytes(b"no picture")
    with pytest.raises(TargetError, match="not a picture"):
        read_pair(tmp_path / "both" / "3.png", None)


def test_stored_pairs_of_two_folders_have_equal_names(tmp_path):
    def write(folder, lefts, rights):
        for eye, names in (("left", lefts), ("right", rights)):
            (tmp_path / folder / eye).mkdir(parents=True)
            for name in names:
                (tmp_path / folder / eye / f"{name}.png").touch()
        return tmp_path / folder

    pairs = stored_pairs(write("whole", ["left9", "left10", "left11"], ["Right11", "Right9", "Right10"]))
    assert [(left.stem, right.stem) for left, right in pairs] == [(f"left{n}", f"Right{n}") for n in (9, 10, 11)]
    with pytest.raises(TargetError, match=r"right picture '.*right/2\.png' has no left one.*first of 2"):
        stored_pairs(write("odd", "01345", "01235"))
    with pytest.raises(TargetError, match="has no right one of the same name"):
        stored_pairs(write("other", ["9", "10"], ["r09", "r10"]))


class Camera:
    """A live camera that shows stored pairs, each three times: at rest."""

    def __init__(self, folder):
        self._frames = [read_pair(left, right) for left, right in stored_pairs(folder) for _ in range(3)]
        self.state, self.skipped = "", 0

    @property
    def ended(self):
        return not self._frames

    def read(self, timeout_s):
        left, right = self._frames.pop(0)
        return StereoFrame(left, right, 0, 0, len(self._frames))

    def close(self):
        pass


def test_live_views_are_kept_until_there_are_enough(scene):
    heard = []
    search = MarkerSearch(machine().camera, dictionary_by_name("DICT_4X4_50"), (1, 2, 3))
    views = live_views(
        Camera(scene[0]), search, TeachSettings(), 4, 60.0, lambda offer, view, kept: heard.append((offer, len(kept)))
    )
    assert len(views) == 4
    assert [offer for offer, _ in heard][:3] == [OfferedView.MOVING, OfferedView.MOVING, OfferedView.TAKEN]
    assert heard[-1] == (OfferedView.TAKEN, 4)


def test_a_camera_that_sends_nothing_is_told_of_after_half_a_minute_not_at_the_end(monkeypatch):
    class Silent:
        ended, state = False, "no connection to http://camera/stream"

        def read(self, timeout_s):
            clock.append(clock[-1] + timeout_s)

    clock = [0.0]
    monkeypatch.setattr("server.camera.target_pictures.time.monotonic", lambda: clock[-1])
    search = MarkerSearch(machine().camera, dictionary_by_name("DICT_4X4_50"), (1, 2, 3))
    with pytest.raises(TargetError, match="no image within 30 s; no connection to http://camera"):
        live_views(Silent(), search, TeachSettings(), 4, 600.0, lambda *_: None)
    assert clock[-1] == 30.0


def test_pictures_of_another_size_are_refused():
    search = MarkerSearch(machine().camera, dictionary_by_name("DICT_4X4_50"), (1, 2, 3))
    with pytest.raises(TargetError, match="640 x 480 px, but the machine file's camera has 1280 x 720"):
        search.view_of(np.zeros((480, 640), np.uint8), np.zeros((480, 640), np.uint8))
