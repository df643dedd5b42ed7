"""When a look is complete, the pipeline of one pair, and the camera track."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_stand_in import picture

from server.camera.contracts import FrameReport, StereoFrame, VisionSettings
from server.camera.looking import LookCollector, TrackCollector
from server.camera.pipeline import VisionPipeline
from server.camera.sources.settings import HttpSource as Http
from server.camera.sources.side_by_side import split_side_by_side
from server.vision.contracts import (
    Array,
    Image,
    Look,
    LookStatus,
    MarkerView,
    ObjectPose,
    OdometryPose,
    OdometryStatus,
    PairObservation,
    PoseStatus,
)

MS = 1_000_000


def observation(t_ns: int, views: tuple[MarkerView, ...] = ()) -> PairObservation:
    unseen = ObjectPose("tool", PoseStatus.NOT_SEEN, "", None, None, (), 0.0, 0.0)
    return PairObservation(t_ns, unseen, replace(unseen, object_name="ooi"), views, ())


def unsearched(number: int, **changes: object) -> FrameReport:
    return report(number, observation=replace(observation(number * 66 * MS), fully_searched=False), **changes)


def odometry_pose(t_ns: int, status: OdometryStatus = OdometryStatus.OK) -> OdometryPose:
    T = np.eye(4)
    T[0, 3] = t_ns * 1e-9
    return OdometryPose(t_ns, T, 1e-8 * np.eye(6), status, "", 100)


def report(number: int, **changes: object) -> FrameReport:
    base = FrameReport(
        observation(number * 66 * MS),
        number * 66 * MS,
        number * 66 * MS,
        number,
        "stereo",
        None,
        15.0,
        9.0,
        0,
        (),
        1.0,
        None,
    )
    return replace(base, **changes)  # pyright: ignore[reportArgumentType]


def look(pairs: Sequence[PairObservation], status: LookStatus) -> Look:
    first, last = pairs[0].t_exposure_ns, pairs[-1].t_exposure_ns
    return Look(status, "", None, None, None, None, len(pairs), len(pairs), first, last, 0.3)


def collector(verdicts: list[LookStatus], n_pairs: int = 4) -> LookCollector:
    return LookCollector(n_pairs, 10 * 66 * MS, "stereo", lambda pairs: look(pairs, verdicts.pop(0)))


def test_only_fresh_healthy_pairs_of_the_wanted_source_count() -> None:
    taking = collector([LookStatus.OK])
    for number in range(10):
        assert taking.add(report(number)) is None  # exposed before the call
    assert taking.add(report(10, pose_source="mono")) is None
    assert taking.add(report(11, warnings=("camera frozen",))) is None
    results = [taking.add(report(number)) for number in range(12, 16)]
    assert results[:3] == [None] * 3
    done = results[3]
    assert done is not None
    assert (done.t_first_ns, done.t_last_ns) == (12 * 66 * MS, 15 * 66 * MS)


def test_a_look_ends_with_a_search_of_the_whole_picture() -> None:
    taking = collector([LookStatus.OK])
    results = [taking.add(unsearched(number)) for number in range(10, 15)]
    assert results == [None] * 5
    done = taking.add(report(15))
    assert done is not None
    assert (done.t_first_ns, done.t_last_ns) == (12 * 66 * MS, 15 * 66 * MS)


def test_pairs_since_the_last_search_go_when_it_finds_a_marker_twice() -> None:
    taking = collector([LookStatus.OK])
    taking.add(report(10))
    for number in (11, 12):
        taking.add(unsearched(number))  # the second marker is there already
    taking.add(report(13, warnings=("marker id 3 is seen at two places",)))
    results = [taking.add(report(number)) for number in range(14, 17)]
    done = results[2]
    assert results[:2] == [None] * 2
    assert done is not None
    assert (done.t_first_ns, done.t_last_ns, done.n_pairs) == (10 * 66 * MS, 16 * 66 * MS, 4)


def test_a_moving_tool_is_looked_at_until_it_rests() -> None:
    taking = collector([LookStatus.NOT_AT_REST] * 3 + [LookStatus.OK])
    results = [taking.add(report(number)) for number in range(10, 20)]
    done = [found for found in results if found is not None]
    assert [found.status for found in done] == [LookStatus.OK]
    assert results.index(done[0]) == 9  # 4 pairs, then 2 more for each of three tries
    assert done[0].t_first_ns == 16 * 66 * MS  # the newest four


def test_an_unseen_tool_gets_one_more_try() -> None:
    taking = collector([LookStatus.TOOL_NOT_SEEN, LookStatus.TOOL_NOT_SEEN])
    results = [taking.add(report(number)) for number in range(10, 16)]
    assert [found is not None for found in results] == [False] * 5 + [True]


def test_time_up_says_why() -> None:
    silent = collector([]).at_timeout(2.0, "camera http://x: timed out")
    assert silent.status is LookStatus.NO_IMAGES
    assert "timed out" in silent.reason
    frozen = collector([])
    frozen.add(report(11, warnings=("camera frozen: its stamp does not advance",)))
    assert "1 pairs were unusable: camera frozen" in frozen.at_timeout(2.0, "").reason
    moving = collector([LookStatus.NOT_AT_REST])
    for number in range(10, 14):
        moving.add(report(number))
    assert moving.at_timeout(2.0, "").status is LookStatus.NOT_AT_REST


def test_track_leaves_out_lost_poses_and_uses_one_offset() -> None:
    taking = TrackCollector(0)
    for number, latency_ms in enumerate((40, 30, 30, 30)):
        status = OdometryStatus.LOST if number == 2 else OdometryStatus.OK
        pose = odometry_pose(number * 66 * MS, status)
        mapped_ns = number * 66 * MS + latency_ms * MS
        taking.add(report(number, odometry=pose, t_exposure_mapped_ns=mapped_ns))
    unknown = replace(odometry_pose(264 * MS, OdometryStatus.DEGRADED), covariance=np.diag([1e-8] * 5 + [0.06**2]))
    taking.add(report(4, odometry=unknown, t_exposure_mapped_ns=294 * MS))  # perhaps one brick off
    taking.add(report(9))
    taking.add(report(9, odometry=odometry_pose(594 * MS, OdometryStatus.OK), odometry_run=7))  # of another run
    track = taking.track()
    np.testing.assert_allclose(track.t_s, [0.030, 0.096, 0.228], atol=1e-12)
    np.testing.assert_allclose(track.Ts_vo_cam[:, 0, 3], [0.0, 0.066, 0.198], atol=1e-12)
    assert TrackCollector(0).track().Ts_vo_cam.shape == (0, 4, 4)


class _Source:
    def __init__(self, views: tuple[MarkerView, ...]) -> None:
        self.views = views

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        return observation(t_exposure_ns, self.views)


class _Odometry:
    made = 0

    def __init__(self) -> None:
        _Odometry.made += 1
        self.masks: list[tuple[int, int]] = []

    def process(
        self,
        left: Image,
        right: Image,
        t_exposure_ns: int,
        mask_polygons_left: Sequence[Array] = (),
        mask_polygons_right: Sequence[Array] = (),
    ) -> OdometryPose:
        self.masks.append((len(mask_polygons_left), len(mask_polygons_right)))
        return odometry_pose(t_exposure_ns)

    def map_points(self, count_max: int) -> Array:
        return np.ones((min(count_max, 7), 3))


def test_pipeline_reports_poses_odometry_preview_and_rate() -> None:
    corners = np.array([[1.0, 1.0], [5.0, 1.0], [5.0, 5.0], [1.0, 5.0]])
    tool = MarkerView(10, corners, corners, 0.1, True, "")
    made: list[_Odometry] = []

    def make() -> _Odometry:
        made.append(_Odometry())
        return made[-1]

    settings = VisionSettings(Http("http://x/"), preview_width_px=40, preview_rate_hz=10.0)
    pipeline = VisionPipeline(settings, [10], {"stereo": _Source((tool,)), "mono": _Source(())}, make)

    def process(number: int) -> FrameReport:
        t_ns = 1_000_000_000 + number * 66 * MS
        eyes = split_side_by_side(picture(90, 100, number))
        return pipeline.process(StereoFrame(*eyes, t_ns - 7, t_ns, number), skipped=3)

    first = process(0)
    assert first.odometry is None
    assert first.preview_jpeg is not None
    decoded = cv2.imdecode(np.frombuffer(first.preview_jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert decoded is not None
    assert decoded.shape == (30, 40)
    pipeline.switch_odometry(True)
    later = [process(number) for number in range(1, 7)]
    assert [one.preview_jpeg is not None for one in later] == [False, True, False, True, False, True]  # at most 10 Hz
    assert all(one.odometry is not None for one in later)
    assert made[0].masks == [(1, 1)] * 6
    assert later[-1].fps == pytest.approx(1.0 / 0.066, rel=1e-6)
    assert later[-1].t_exposure_mapped_ns == later[-1].t_receive_mono_ns
    pipeline.use_pose_source("mono")
    pipeline.switch_odometry(True, masks=True)
    again = process(8)
    assert len(made) == 2  # a fresh start frame
    assert (again.pose_source, again.observation.marker_views, again.n_skipped) == ("mono", (), 3)
    ended = pipeline.switch_odometry(False)
    assert ended is not None
    assert ended.points_vo.shape == (7, 3)  # for looking at
    assert ended.still_masks == (None, None)  # one pair says nothing of what stands still
    assert pipeline.switch_odometry(False) is None
    assert process(9).odometry is None
