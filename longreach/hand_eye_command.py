"""`longreach hand-eye`: hand-eye calibration from poses of hand and target, with covariance."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.layout import neutral_sets
from machine.effects.structure import tcp_poses
from machine.errors import MachineError
from machine.rotations import Array, rotation_from_quat_wxyz
from recording.errors import RecordingError
from recording.files import read_text, write_durably
from recording.foreign.mapping import UrdfChain
from recording.foreign.ros_bag import NotDecodedError, RosBag
from recording.foreign.ros_collect import JOINT_STATE_TYPE
from recording.foreign.urdf_ends import chain_for
from server.calibration.hand_eye import HandEyeEstimate, HandPoses, estimate_hand_eye, solve_ax_yb
from server.calibration.hand_eye_fit import inverse_poses, rotation_vectors
from server.camera.target_pictures import charuco_board
from server.commissioning.hand_eye_poses import (
    HandEyeError,
    Mount,
    PoseTable,
    matching_label_rows,
    mount_sigmas,
    poses_of_pictures,
    read_lens,
    read_poses,
    write_mount,
)

SIMILAR_POSES_SHOWN_MAX = 8
HAND_POSE_GAP_MAX_S = 0.2


# Poses for a hand-eye calibration from a ROS bag: the hand by joint states and URDF, the target by a pose topic.

POSES_MAX = 1_000_000


def poses_of_bag(bag: Path, topic: str, urdf: Path, base_link: str, hand_link: str) -> tuple[PoseTable, PoseTable]:
    """The hand in the base and the target in the camera, each with the times of its headers.

    Args:   topic: geometry_msgs/PoseStamped of the target in the camera. base_link, hand_link: of the URDF; empty: the
            root, and the link that the last recorded joint moves.
    Raises: HandEyeError: no such poses, no joint states, or a URDF of another robot.
    """
    joints: dict[tuple[str, ...], list[tuple[float, list[float]]]] = {}
    seen: list[tuple[float, list[float]]] = []
    topics = set[str]()
    try:
        for message in RosBag(bag):
            topics.add(message.topic)
            if message.topic != topic and message.message_type != JOINT_STATE_TYPE:
                continue
            if len(seen) + sum(map(len, joints.values())) >= POSES_MAX:
                raise HandEyeError(f"{bag} holds more than {POSES_MAX} poses and joint states; cut it")
            fields = message.decode()
            stamp = fields.header.stamp
            t_s = (stamp.sec + 1e-9 * stamp.nanosec) or 1e-9 * message.t_ns
            if message.topic == topic:
                place, turn = fields.pose.position, fields.pose.orientation
                seen.append((t_s, [place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z]))
            elif len(fields.position) == len(fields.name):
                joints.setdefault(tuple(fields.name), []).append((t_s, list(fields.position)))
        if not seen or not joints:
            missing = f"poses on {topic}" if not seen else "joint states"
            raise HandEyeError(f"{bag} holds no {missing}; its topics are {', '.join(sorted(topics)[:20])}")
        names, rows = max(joints.items(), key=lambda one: len(one[1]))
        text = read_text(urdf)
        chain = chain_for(text, names, UrdfChain(base_link=base_link, tip_link=hand_link))
        moving = [joint.name for joint in chain.joints if joint.name in names]
        arm, _ = arm_from_urdf(text, chain.base_link, chain.tip_link, moving)
    except (RecordingError, MachineError, NotDecodedError, AttributeError) as error:
        raise HandEyeError(f"{bag}: {error}") from error
    except OSError as error:
        raise HandEyeError(f"{urdf} cannot be read: {error.strerror}") from error
    q = np.array([row for _, row in rows])[:, [names.index(name) for name in moving]]
    hand = PoseTable((), np.array([t for t, _ in rows]), tcp_poses(arm, neutral_sets(arm.n), q))
    Ts = np.tile(np.eye(4), (len(seen), 1, 1))
    for k, (_, row) in enumerate(seen):
        Ts[k, :3, 3], quat = row[:3], np.array(row[3:])
        Ts[k, :3, :3] = rotation_from_quat_wxyz(quat / max(float(np.linalg.norm(quat)), 1e-12))
    return hand, PoseTable((), np.array([t for t, _ in seen]), Ts)


# What a hand-eye calibration leaves, pose by pose: residuals, outliers, and poses too alike to add anything.

OUTLIER_SIGMAS = 4.0
SIMILAR_POSE_ANGLE_MAX_RAD = float(np.deg2rad(3.0))
SIMILAR_POSE_DISTANCE_MAX_M = 0.02


@dataclass(frozen=True, slots=True)
class PoseResiduals:
    """Of every pose (n,): how far the target is turned [deg] and lies [mm, in the camera] from where it should be."""

    rotation_deg: Array
    translation_mm: Array
    outlier_mask: NDArray[np.bool_]


def pose_residuals(As: Array, Bs: Array, X: Array, Y: Array) -> PoseResiduals:
    """What A X = Y B leaves. Outliers lie beyond four robust sigmas of the rest, in turn or in place.

    Args: As: base from hand, Bs: target from camera (n, 4, 4); X: hand from camera, Y: base from target (4, 4).
    """
    predicted = inverse_poses(As @ X) @ Y
    seen = inverse_poses(Bs)
    turns = np.rad2deg(np.linalg.norm(rotation_vectors(inverse_poses(predicted)[:, :3, :3] @ seen[:, :3, :3]), axis=1))
    misses = 1e3 * np.linalg.norm(predicted[:, :3, 3] - seen[:, :3, 3], axis=1)
    return PoseResiduals(turns, misses, _is_outlier(turns) | _is_outlier(misses))


def _is_outlier(sizes: Array) -> NDArray[np.bool_]:
    """Sizes (norms of three components) beyond so many sigmas of a component, robustly."""
    sigma = float(np.median(sizes)) / 1.5382  # median of a norm of three normal components
    return np.asarray(sizes > (OUTLIER_SIGMAS + 1.0) * max(sigma, 1e-9))


def alike_poses(As: Array) -> list[tuple[int, int]]:
    """Pairs of poses (first the earlier one) turned by less than 3 deg and moved by less than 20 mm: one of them is
    enough. Every pose is named with the first one that it is alike.
    """
    pairs = []
    for k in range(1, len(As)):
        turns = np.linalg.norm(rotation_vectors(np.swapaxes(As[:k, :3, :3], 1, 2) @ As[k, :3, :3]), axis=1)
        moved = np.linalg.norm(As[:k, :3, 3] - As[k, :3, 3], axis=1)
        near = np.nonzero((turns < SIMILAR_POSE_ANGLE_MAX_RAD) & (moved < SIMILAR_POSE_DISTANCE_MAX_M))[0]
        if len(near):
            pairs.append((int(near[0]), k))
    return pairs


@dataclass(frozen=True, slots=True)
class Solved:
    """An estimate, and the pairs of poses that it was judged by."""

    estimate: HandEyeEstimate
    hand_poses: Array
    target_from_camera: Array
    pose_labels: tuple[str, ...]


def hand_eye(
    hand: Annotated[
        Path | None,
        typer.Option("--hand", help="poses of the hand in the base: time or name, x, y, z [m], qx, qy, qz, qw"),
    ] = None,
    camera: Annotated[
        Path | None, typer.Option("--camera", help="poses of the target in the camera, of the same times or names")
    ] = None,
    images: Annotated[
        Path | None, typer.Option("--images", help="instead of --camera: pictures of a board, named as the poses")
    ] = None,
    lens: Annotated[Path | None, typer.Option("--lens", help="of the pictures: ROS camera_info or OpenCV YAML")] = None,
    squares: Annotated[str, typer.Option(help="the board's squares across and down, such as 11x8")] = "",
    square_mm: Annotated[float, typer.Option(help="side of a square [mm], measured on the print")] = 0.0,
    marker_mm: Annotated[float, typer.Option(help="side of a marker [mm]")] = 0.0,
    dictionary: Annotated[str, typer.Option(help="the markers' dictionary")] = "DICT_5X5_100",
    legacy_pattern: Annotated[bool, typer.Option(help="a board printed with OpenCV before 4.6")] = False,
    bag: Annotated[Path | None, typer.Option("--bag", help="a ROS bag in place of --hand and --camera")] = None,
    pose_topic: Annotated[str, typer.Option(help="of the bag: PoseStamped of the target in the camera")] = "",
    urdf: Annotated[Path | None, typer.Option("--urdf", help="of the bag: the robot; its joint states move it")] = None,
    inverse_camera: Annotated[
        bool, typer.Option("--camera-in-target", help="--camera holds the camera in the target")
    ] = False,
    eye_to_hand: Annotated[
        bool, typer.Option("--eye-to-hand", help="the camera is fixed next to the robot, and the hand holds the target")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="folder for TF, easy_handeye2, URDF and machine file")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the full result here (JSON)")] = None,
    base_frame: Annotated[str, typer.Option(help="name of the robot's base frame")] = "base_link",
    hand_frame: Annotated[str, typer.Option(help="name of the hand's frame")] = "tool0",
    camera_frame: Annotated[str, typer.Option(help="name of the camera's optical frame")] = "camera_optical_frame",
    target_frame: Annotated[str, typer.Option(help="name of the target's frame")] = "target",
) -> None:
    """Hand-eye calibration from poses of hand and target. Exit code 0: found, 1: not found; the reason is printed."""
    screen, covariances, hand_table = Console(), None, PoseTable((), None, np.zeros((0, 4, 4)))
    if bag is None and (hand is None or (camera is None) == (images is None)):
        raise typer.BadParameter("give --bag, or --hand and either --camera, poses of the target, or --images")
    if bag is not None:
        if urdf is None or not pose_topic:
            raise typer.BadParameter("--bag needs --pose-topic and --urdf")
        hand_table, table = poses_of_bag(bag, pose_topic, urdf, "", "")
        seen = replace(table, poses=inverse_poses(table.poses)) if inverse_camera else table
    elif camera is not None:
        table = read_poses(camera)
        seen = replace(table, poses=inverse_poses(table.poses)) if inverse_camera else table
    else:
        assert images is not None  # one of both is given
        if lens is None:
            raise typer.BadParameter("--images needs --lens, the camera's camera_info or OpenCV YAML")
        board = charuco_board(squares, square_mm, marker_mm, dictionary, legacy_pattern)
        found_poses = poses_of_pictures(images, board, read_lens(lens))
        seen, covariances = found_poses.pose_table, found_poses.pose_covariances
        for name, why in found_poses.skipped_pictures:
            screen.print(f"[yellow]without a pose[/] {escape(name)}: {escape(why)}", soft_wrap=True)
    if bag is None:
        assert hand is not None  # asked above
        hand_table = read_poses(hand)
    solved = solve_hand_eye(hand_table, seen, eye_to_hand, covariances)
    found = solved.estimate
    alike = alike_poses(solved.hand_poses) if len(solved.hand_poses) <= 200 else []
    answer: dict[str, Any] = {
        "status": found.status.name,
        "reason": found.reason,
        "n": len(solved.hand_poses),
        "n_used": found.n_used,
    }
    answer["alike"] = [[solved.pose_labels[first], solved.pose_labels[second]] for first, second in alike]
    if found.T_hand_cam is None or found.T_base_target is None or found.covariance is None:
        screen.print(f"[bold red]not found[/]: {escape(found.reason)}", soft_wrap=True)
        _show_alike(alike, solved.pose_labels, screen)
        _write_json(json_file, answer)
        raise typer.Exit(1)
    left = pose_residuals(solved.hand_poses, solved.target_from_camera, found.T_hand_cam, found.T_base_target)
    mount = _mount_from_estimate(found, eye_to_hand, (base_frame, hand_frame, camera_frame, target_frame))
    _show_mount(mount, found, left, solved, screen)
    _show_alike(alike, solved.pose_labels, screen)
    answer |= _as_answer(mount, found, left, solved)
    _write_json(json_file, answer)
    if out is not None:
        try:
            written = write_mount(mount, out)
        except OSError as error:
            raise HandEyeError(f"{out} cannot be written: {error.strerror}") from error
        screen.print("written: " + escape(", ".join(str(path) for path in written)), soft_wrap=True)


def solve_hand_eye(hand: PoseTable, seen: PoseTable, eye_to_hand: bool, covariances: Array | None = None) -> Solved:
    """A X = Y B, by pairs of equal labels, else by two streams whose clocks differ.

    Model:   eye in hand: A = base from hand, B = target from camera, X = hand from camera, Y = base from target. Eye to
             hand: B = camera from target, X = hand from target, Y = base from camera.
    Args:    seen: the target in the camera; covariances: of it (n, 6, 6), used with the eye in hand.
    Raises:  HandEyeError: neither equal labels nor times.
    """
    pairs = matching_label_rows(hand, seen)
    if pairs is not None:
        As, Ts_cam_target = hand.poses[pairs[0]], seen.poses[pairs[1]]
        labels = tuple(seen.labels[k] for k in pairs[1])
        Bs = Ts_cam_target if eye_to_hand else inverse_poses(Ts_cam_target)
        weights = None if covariances is None or eye_to_hand else covariances[pairs[1]]
        return Solved(solve_ax_yb(As, Bs, camera_covariances=weights), As, Bs, labels)
    if hand.t_s is None or seen.t_s is None:
        raise HandEyeError("hand and camera share no names and have no times; give both tables the same first column")
    hand_t, hand_T = _in_order(hand.t_s, hand.poses)
    cam_t, cam_T = _in_order(seen.t_s, seen.poses)
    start = hand_t[0]
    found = estimate_hand_eye(hand_t - start, hand_T, cam_t - start, inverse_poses(cam_T) if eye_to_hand else cam_T)
    track = HandPoses(hand_t - start, hand_T, HAND_POSE_GAP_MAX_S)
    inside = track.covers_times(cam_t - start + found.time_offset_s, 0.0)
    As = track.poses_at(cam_t[inside] - start + found.time_offset_s) if inside.any() else np.zeros((0, 4, 4))
    Bs = cam_T[inside] if eye_to_hand else inverse_poses(cam_T[inside])
    return Solved(found, As, Bs, tuple(f"{t:.3f}" for t in cam_t[inside]))


def _in_order(t_s: Array, Ts: Array) -> tuple[Array, Array]:
    """Rows by time; of equal times the first one."""
    _, first = np.unique(t_s, return_index=True)
    return t_s[first], Ts[first]


def _mount_from_estimate(found: HandEyeEstimate, eye_to_hand: bool, names: tuple[str, str, str, str]) -> Mount:
    assert found.T_hand_cam is not None  # the caller asked
    assert found.T_base_target is not None
    assert found.covariance is not None
    part = slice(6, 12) if eye_to_hand else slice(0, 6)
    T = found.T_base_target if eye_to_hand else found.T_hand_cam
    return Mount(T, found.covariance[part, part], not eye_to_hand, *names)


def _show_mount(mount: Mount, found: HandEyeEstimate, left: PoseResiduals, solved: Solved, screen: Console) -> None:
    turned, moved = mount_sigmas(mount)
    T = mount.T_parent_cam
    table = Table(title=f"{mount.camera_frame} in {mount.parent_frame}", title_justify="left", show_header=False)
    table.add_row(
        "translation, mm", "  ".join(f"{1e3 * x:.2f} +- {s:.2f}" for x, s in zip(T[:3, 3], moved, strict=True))
    )
    table.add_row("rotation known to, deg", "  ".join(f"{s:.3f}" for s in turned))
    table.add_row("poses", f"{len(solved.hand_poses)}, of which {found.n_used} count fully")
    for name, values, unit in (
        ("residual rotation", left.rotation_deg, "deg"),
        ("residual place", left.translation_mm, "mm"),
    ):
        middle, high = np.median(values), np.percentile(values, 90)
        table.add_row(name, f"median {middle:.3f}, 90 % below {high:.3f}, largest {values.max():.3f} {unit}")
    table.add_row("second rotation axis", f"{np.rad2deg(found.axis_spread_rad):.1f} deg rms")
    if found.reason:
        table.add_row("clocks", found.reason)
    screen.print(table)
    places = np.nonzero(left.outlier_mask)[0]
    if len(places):
        shown = ", ".join(
            f"{solved.pose_labels[k]} ({left.rotation_deg[k]:.2f} deg, {left.translation_mm[k]:.1f} mm)"
            for k in places[:SIMILAR_POSES_SHOWN_MAX]
        )
        screen.print(
            f"[yellow]outliers[/], {len(places)}: {escape(shown)}: check their images, or leave them out",
            soft_wrap=True,
        )


def _show_alike(alike: list[tuple[int, int]], labels: tuple[str, ...], screen: Console) -> None:
    if alike:
        shown = ", ".join(f"{labels[second]} like {labels[first]}" for first, second in alike[:SIMILAR_POSES_SHOWN_MAX])
        text = f"[yellow]too alike[/], {len(alike)}: {escape(shown)}: turn the hand further between poses"
        screen.print(text, soft_wrap=True)


def _as_answer(mount: Mount, found: HandEyeEstimate, left: PoseResiduals, solved: Solved) -> dict[str, Any]:
    return {
        "setup": "eye_in_hand" if mount.in_hand else "eye_to_hand",
        "parent_frame": mount.parent_frame,
        "T_parent_cam": mount.T_parent_cam.tolist(),
        "covariance": mount.pose_covariance.tolist(),
        "residual_rotation_deg": {"median": float(np.median(left.rotation_deg)), "max": float(left.rotation_deg.max())},
        "residual_mm": {"median": float(np.median(left.translation_mm)), "max": float(left.translation_mm.max())},
        "outliers": [solved.pose_labels[k] for k in np.nonzero(left.outlier_mask)[0]],
        "time_offset_s": found.time_offset_s,
    }


def _write_json(path: Path | None, answer: dict[str, Any]) -> None:
    if path is None:
        return
    try:
        write_durably(path, json.dumps(answer, indent=1) + "\n")
    except OSError as error:
        raise HandEyeError(f"{path} cannot be written: {error.strerror}") from error
