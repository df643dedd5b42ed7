"""[camera] of the settings file: every kind of source, and errors that name the field."""

import pickle
from pathlib import Path

import pytest
from rig_samples import EUROC_LEFT, EUROC_RIGHT, ZED

from longreach.serve_command import _with_options
from longreach.target_command import live_camera
from machine.description import parse_machine_toml
from server.camera.rectification import rectification_of
from server.camera.sources.settings import (
    DeviceSource,
    EurocSource,
    FileSource,
    FolderSource,
    HttpSource,
    RecordingSource,
    RectifiedSource,
    RtspSource,
    SourceSettings,
)
from server.errors import SettingsError
from server.settings import read_machine, read_machine_text, read_settings
from server.settings_camera import with_stream
from server.settings_source import machine_text_with_camera, source_and_machine

MACHINE = read_machine("hiab033")


def source_of(tmp_path: Path, section: str) -> SourceSettings:
    path = tmp_path / "settings.toml"
    path.write_text(f"[camera]\n{section}\n")
    return source_and_machine(read_settings(path).camera, MACHINE)[0]


@pytest.mark.parametrize(
    ("section", "wanted"),
    [
        ('kind = "http"\nurl = "http://cam:8090/stream"', HttpSource("http://cam:8090/stream")),
        ('kind = "device"', DeviceSource(0, 2560, 720, 60.0, "YUYV")),
        (
            'kind = "device"\npath = "/dev/v4l/by-id/zed"\nwidth_px = 1344\nheight_px = 376\nrate_hz = 100.0\n'
            'pixel_format = "MJPG"',
            DeviceSource("/dev/v4l/by-id/zed", 1344, 376, 100.0, "MJPG"),
        ),
        ('kind = "rtsp"\nurl = "rtsp://cam/both"\ntimeout_s = 2.0', RtspSource("rtsp://cam/both", 2.0)),
        ('kind = "rtsp"\nurl = "rtsp://c/b"\naccept_inter_coded = true', RtspSource("rtsp://c/b", 5.0, True)),
        ('kind = "file"\npath = "a.mp4"', FileSource("a.mp4")),
        ('kind = "folder"\nleft_glob = "l/*"\nright_glob = "r/*"\nrate_hz = 10.0', FolderSource("l/*", "r/*", 10.0)),
        ('kind = "euroc"\npath = "V1_01"\nspeed = 0.5', EurocSource("V1_01", 0.5)),
        ('kind = "recording"\npath = "a.mcap"\npair_topic = "/pair"', RecordingSource("a.mcap", pair_topic="/pair")),
    ],
)
def test_every_kind_can_be_chosen(tmp_path: Path, section: str, wanted: SourceSettings) -> None:
    assert source_of(tmp_path, section) == wanted


@pytest.mark.parametrize(
    ("section", "field"),
    [
        ('kind = "usb"', "camera"),
        ('kind = "http"\nurl = "ftp://cam"', "camera.http.url"),
        ('kind = "device"\nwidth_px = 2561', "camera.device.width_px"),
        ('kind = "device"\nrate_hz = 0.0', "camera.device.rate_hz"),
        ('kind = "device"\npixel_format = "H264"', "camera.device.pixel_format"),
        ('kind = "rtsp"', "camera.rtsp.url"),
        ('kind = "euroc"\npath = "a"\nspeed = 0.0', "camera.euroc.speed"),
        ('kind = "recording"\npath = "a"\ntopic = "/x"', "camera.recording.topic"),
        ('kind = "file"\npath = "a"\ncalibration = ["1", "2", "3"]', "camera.file.calibration"),
    ],
)
def test_faults_name_the_field(tmp_path: Path, section: str, field: str) -> None:
    with pytest.raises(SettingsError, match=field.replace(".", r"\.")):
        source_of(tmp_path, section)


def test_without_a_calibration_the_machine_stays(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text('[camera]\nkind = "device"\n')
    assert source_and_machine(read_settings(path).camera, MACHINE)[1] is MACHINE


def test_calibration_puts_the_rectified_camera_into_the_machine(tmp_path: Path) -> None:
    (tmp_path / "SN1.conf").write_text(ZED)
    path = tmp_path / "settings.toml"
    path.write_text(f'[camera]\nkind = "device"\ncalibration = "{tmp_path}/SN1.conf"\n')
    source, machine = source_and_machine(read_settings(path).camera, MACHINE)
    assert isinstance(source, RectifiedSource)
    assert source.source == DeviceSource(0, 2560, 720, 60.0, "YUYV")
    assert (source.rig.width_px, source.rig.height_px) == (1280, 720)  # half of the device's 2560: the HD section
    assert machine.camera.rectified
    assert machine.camera.baseline_m == pytest.approx(0.119978, abs=1e-6)
    assert machine.markers == MACHINE.markers
    path.write_text(
        f'[camera]\nkind = "device"\nwidth_px = 4416\nheight_px = 1242\ncalibration = "{tmp_path}/SN1.conf"\n'
    )
    assert source_and_machine(read_settings(path).camera, MACHINE)[1].camera.width_px == 2208


def test_a_layout_is_taught_through_the_calibration_that_the_server_looks_through(tmp_path: Path) -> None:
    (tmp_path / "SN1.conf").write_text(ZED)
    path = tmp_path / "settings.toml"
    path.write_text(f'[camera]\nkind = "device"\ncalibration = "{tmp_path}/SN1.conf"\n')
    source, camera = live_camera(None, path, MACHINE)
    assert isinstance(source, RectifiedSource)
    assert camera == source_and_machine(read_settings(path).camera, MACHINE)[1].camera
    assert live_camera("http://127.0.0.1:1/stream", path, MACHINE)[1] is MACHINE.camera


def test_the_machine_text_of_a_recording_holds_the_rectified_camera(tmp_path: Path) -> None:
    (tmp_path / "SN1.conf").write_text(ZED)
    path = tmp_path / "settings.toml"
    path.write_text(f'[camera]\nkind = "device"\ncalibration = "{tmp_path}/SN1.conf"\n')
    _, machine = source_and_machine(read_settings(path).camera, MACHINE)
    again = parse_machine_toml(machine_text_with_camera(read_machine_text("hiab033"), machine.camera))
    assert again.camera == machine.camera
    assert again.T_tcp_cam_left.tolist() == MACHINE.T_tcp_cam_left.tolist()
    assert [marker.marker_id for marker in again.markers] == [marker.marker_id for marker in MACHINE.markers]


def test_a_rectified_source_reaches_the_vision_process_whole(tmp_path: Path) -> None:
    (tmp_path / "SN1.conf").write_text(ZED)
    path = tmp_path / "settings.toml"
    path.write_text(f'[camera]\nkind = "http"\ncalibration = "{tmp_path}/SN1.conf"\n')
    source, machine = source_and_machine(read_settings(path).camera, MACHINE)
    arrived = pickle.loads(pickle.dumps(source))
    assert isinstance(arrived, RectifiedSource)
    assert rectification_of(arrived.rig, arrived.rate_hz).camera == machine.camera


def test_calibration_of_a_data_set_by_its_folder_or_two_files(tmp_path: Path) -> None:
    for eye, text in (("cam0", EUROC_LEFT), ("cam1", EUROC_RIGHT)):
        (tmp_path / "mav0" / eye).mkdir(parents=True)
        (tmp_path / "mav0" / eye / "sensor.yaml").write_text(text)
    path = tmp_path / "settings.toml"
    pair = [f"{tmp_path}/mav0/{eye}/sensor.yaml" for eye in ("cam0", "cam1")]
    for calibration in (f'"{tmp_path}"', f'["{pair[0]}", "{pair[1]}"]'):
        path.write_text(f'[camera]\nkind = "euroc"\npath = "{tmp_path}"\ncalibration = {calibration}\n')
        assert source_and_machine(read_settings(path).camera, MACHINE)[1].camera.width_px == 752


@pytest.mark.parametrize("kind", ['kind = "http"', 'kind = "device"', 'kind = "rtsp"\nurl = "rtsp://cam/both"'])
def test_a_stream_on_the_command_line_keeps_the_rig_of_the_file(tmp_path: Path, kind: str) -> None:
    """Pictures that are not rectified any more put every pose off, and nothing says so."""
    path = tmp_path / "settings.toml"
    path.write_text(
        f"[camera]\n{kind}\ncalibration = 'SN1.conf'\neye_width_px = 1280\neye_height_px = 720\n"
        "mask_left = 'left.png'\n"
    )
    section = read_settings(path).camera
    rig = {"calibration": "SN1.conf", "eye_width_px": 1280, "eye_height_px": 720, "off_centre": False}
    rig |= {"mask_left": "left.png", "mask_right": ()}
    assert with_stream(section, "http://cam/s") == {"kind": "http", "url": "http://cam/s", **rig}
    assert with_stream(section, "") == section.model_dump() == with_stream(section, None)
    served = _with_options(
        read_settings(path), {"camera": with_stream(section, "http://cam/s"), "http": {"port": None}}
    )
    assert served.camera.model_dump() == {"kind": "http", "url": "http://cam/s", **rig}
