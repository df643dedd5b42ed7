"""A calibrated lens or rig in the formats of others: ROS camera_info, OpenCV, Kalibr, and ZED's conf."""

from pathlib import Path

import cv2
import numpy as np
import yaml

from machine.rotations import Array, rotation_from_rotvec
from recording.files import write_durably
from server.calibration.lens_fit import LensFit
from server.camera.rectification_zed import SECTIONS

NAMES = {1: ("camera",), 2: ("left", "right")}


def write_lens(fit: LensFit, folder: Path) -> tuple[list[Path], list[str]]:
    """Write all forms that can hold it; the files, and why another is not written. Raises: OSError."""
    texts = {f"{name}.yaml": camera_info(fit, eye) for eye, name in enumerate(NAMES[len(fit.lenses)])}
    texts |= {"kalibr.yaml": kalibr(fit), "opencv.yaml": opencv(fit)}
    notes = []
    if fit.rig is None:
        notes.append("no ZED conf: it is of two eyes")
    elif fit.size_px not in SECTIONS:
        sizes = ", ".join(f"{width} x {height}" for width, height in SECTIONS)
        notes.append(f"no ZED conf: it knows {sizes} px an eye only")
    else:
        texts["zed.conf"] = zed(fit)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_durably(folder / name, text)
    return [folder / name for name in texts], notes


def _matrix(fit: LensFit, eye: int) -> Array:
    fx, fy, cx, cy = fit.lenses[eye, :4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _place(fit: LensFit) -> tuple[Array, Array]:
    """R and t [m] that take the left eye's points to the right one's."""
    assert fit.rig is not None  # two eyes
    return rotation_from_rotvec(fit.rig[:3]), fit.rig[3:]


def _rectified(fit: LensFit) -> list[tuple[Array, Array]]:
    """Rectification and projection of each eye."""
    if fit.rig is None:
        return [(np.eye(3), np.hstack([_matrix(fit, 0), np.zeros((3, 1))]))]
    R, t = _place(fit)
    lenses = [(_matrix(fit, eye), fit.lenses[eye, 4:].copy()) for eye in (0, 1)]
    R1, R2, P1, P2 = cv2.stereoRectify(*lenses[0], *lenses[1], fit.size_px, R, t[:, None], alpha=0.0)[:4]
    return [(np.asarray(R1, float), np.asarray(P1, float)), (np.asarray(R2, float), np.asarray(P2, float))]


def camera_info(fit: LensFit, eye: int) -> str:
    """sensor_msgs/CameraInfo in YAML, as ROS's camera_info_manager reads it."""
    R, P = _rectified(fit)[eye]
    body = {
        "image_width": fit.size_px[0],
        "image_height": fit.size_px[1],
        "camera_name": NAMES[len(fit.lenses)][eye],
        "camera_matrix": _data(_matrix(fit, eye)),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _data(fit.lenses[eye, None, 4:]),
        "rectification_matrix": _data(R),
        "projection_matrix": _data(P),
    }
    return yaml.safe_dump(body, sort_keys=False, default_flow_style=None)


def _data(values: Array) -> dict[str, object]:
    rows, cols = values.shape
    return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}


def opencv(fit: LensFit) -> str:
    """OpenCV's stereo YAML, with the names of its samples."""
    if fit.rig is None:
        return _file_storage({"camera_matrix": _matrix(fit, 0), "distortion_coefficients": fit.lenses[:1, 4:]}, fit)
    R, t = _place(fit)
    matrices = {"K1": _matrix(fit, 0), "D1": fit.lenses[:1, 4:], "K2": _matrix(fit, 1), "D2": fit.lenses[1:, 4:]}
    return _file_storage(matrices | {"R": R, "T": t[:, None]}, fit)


def _file_storage(matrices: dict[str, Array], fit: LensFit) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("image_width", fit.size_px[0])
    storage.write("image_height", fit.size_px[1])
    for name, values in matrices.items():
        storage.write(name, np.ascontiguousarray(values))
    return storage.releaseAndGetString()


def kalibr(fit: LensFit) -> str:
    """Kalibr's camchain; it has four coefficients, so a k3 that matters is lost, and that is said in the file."""
    body: dict[str, object] = {}
    for eye in range(len(fit.lenses)):
        camera: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": fit.lenses[eye, :4].tolist(),
            "distortion_model": "radtan",
            "distortion_coeffs": fit.lenses[eye, 4:8].tolist(),
            "resolution": list(fit.size_px),
            "rostopic": f"/cam{eye}/image_raw",
        }
        if eye == 1:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = _place(fit)
            camera["T_cn_cnm1"] = T.tolist()
        body[f"cam{eye}"] = camera
    lost = ", ".join(f"{value:.6g}" for value in fit.lenses[:, 8])
    return f"# radtan has no k3; left out: {lost}\n" + yaml.safe_dump(body, sort_keys=False, default_flow_style=None)


def zed(fit: LensFit) -> str:
    """ZED's conf at this image size."""
    ending = SECTIONS[fit.size_px]
    lines = []
    for eye, side in enumerate(("LEFT", "RIGHT")):
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = fit.lenses[eye].tolist()
        lines += [f"[{side}_CAM_{ending}]", f"fx={fx!r}", f"fy={fy!r}", f"cx={cx!r}", f"cy={cy!r}"]
        lines += [f"k1={k1!r}", f"k2={k2!r}", f"p1={p1!r}", f"p2={p2!r}", f"k3={k3!r}", ""]
    assert fit.rig is not None  # the caller asked
    rx, ry, rz = fit.rig[:3].tolist()
    baseline, ty, tz = (-1e3 * fit.rig[3:]).tolist()
    lines += ["[STEREO]", f"Baseline={baseline!r}", f"TY={ty!r}", f"TZ={tz!r}"]
    lines += [f"RX_{ending}={rx!r}", f"CV_{ending}={ry!r}", f"RZ_{ending}={rz!r}", ""]
    return "\n".join(lines)
