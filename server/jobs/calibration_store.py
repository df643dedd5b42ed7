"""The local calibration on disk: kept after each job that changed it, taken up at the start if it still holds."""

import hashlib
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machine.effects.entries import EffectEntry, entries_to_toml
from recording.files import write_durably
from server.calibration.calibration_file import (
    CalibrationFileError,
    SavedCalibration,
    calibration_text,
    parse_calibration,
)
from server.calibration.calibration_life import CalibrationExpiry, LocalCalibration, observability_text
from server.calibration.contracts import CalibrationStatus, CameraRotationEstimate
from server.jobs.knowledge import Knowledge
from server.jobs.records import CalibrationRecord

log = logging.getLogger(__name__)

CALIBRATION_FILE_NAME = "calibration.json"


def machine_id_of(machine_text: str, compensated: tuple[EffectEntry, ...] = ()) -> str:
    """A fingerprint of the machine file and of what is compensated: a calibration made with others does not hold."""
    return hashlib.sha256((machine_text + entries_to_toml(compensated)).encode()).hexdigest()[:16]


@dataclass(slots=True)
class CalibrationStore:
    """One file. `path` None keeps nothing."""

    path: Path | None
    _kept: LocalCalibration | None = None

    def save_if_changed(self, knowledge: Knowledge) -> None:
        """Write the calibration if it changed; a full disk is logged and noted, it does not end a job."""
        life = knowledge.kept_calibration
        if self.path is None or life is None or life is self._kept:
            return
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_durably(self.path, calibration_text(SavedCalibration(life, tuple(knowledge.odometry_runs))))
            self._kept, knowledge.calibration_note = life, ""
        except (OSError, ValueError) as error:  # a value that is not a finite number cannot be written either
            why = error.strerror if isinstance(error, OSError) else error
            knowledge.calibration_note = f"calibration is not saved: {self.path}: {why}"
            log.error(knowledge.calibration_note)

    def restore(
        self,
        knowledge: Knowledge,
        machine_id: str,
        n_joints: int,
        t_unix_s: float,
        expiry: CalibrationExpiry | None = None,
    ) -> None:
        """Take up the kept calibration, or note why not. Where it holds is asked when it is used.

        Args: expiry: of the settings as they are now, in place of those that the file was written under.
        """
        if self.path is None or not self.path.exists():
            return
        try:
            saved = parse_calibration(self.path.read_text(encoding="utf-8"))
            if expiry is not None:
                saved = replace(saved, calibration=replace(saved.calibration, expiry=expiry))
            self._take_up(knowledge, saved, machine_id, n_joints, t_unix_s)
        except (OSError, UnicodeDecodeError, CalibrationFileError) as error:
            knowledge.calibration_note = f"saved calibration {self.path} was not loaded: {error}"
            log.warning(knowledge.calibration_note)

    def _take_up(
        self, knowledge: Knowledge, saved: SavedCalibration, machine_id: str, n_joints: int, t_unix_s: float
    ) -> None:
        one = saved.calibration
        if one.machine_id != machine_id:
            raise CalibrationFileError("it was made with another machine, camera or compensation file; calibrate again")
        if one.made_at.q.shape != (n_joints,) or any(
            run.joint_track.qs.shape[1] != n_joints for run in saved.odometry_runs
        ):
            raise CalibrationFileError(f"it has {one.made_at.q.size} joints, the machine {n_joints}; calibrate again")
        found = one.valid_at(t_unix_s, one.made_at.q, one.made_at.T_base_tcp)
        if not found.ok:
            raise CalibrationFileError(found.reason)
        knowledge.kept_calibration = self._kept = one
        knowledge.mount_rotation_estimate, knowledge.calibration_record = (
            _rotation_estimate(one),
            _calibration_record(one),
        )
        knowledge.odometry_runs[:] = saved.odometry_runs


def _rotation_estimate(one: LocalCalibration) -> CameraRotationEstimate:
    return CameraRotationEstimate(
        status=CalibrationStatus.OK,
        reason="",
        method=one.method,
        R_tcp_cam=one.R_tcp_cam,
        covariance=one.covariance,
        time_offset_s=one.time_offset_s,
        residual_rms_mm=one.residual_rms_mm,
        residual_max_mm=one.residual_max_mm,
        n_used=one.n_used,
        observability=one.observability,
        path_length_m=one.path_length_m,
    )


def _calibration_record(one: LocalCalibration) -> CalibrationRecord:
    return CalibrationRecord(
        method=one.method,
        status="ok",
        reason=f"saved earlier; {observability_text(one)}",
        sigma_deg=float(np.rad2deg(one.sigmas_rad[-1])),
        from_nominal_deg=one.from_nominal_deg,
        time_offset_ms=1e3 * one.time_offset_s,
        residual_rms_mm=one.residual_rms_mm,
        n_used=one.n_used,
        observability=one.observability,
        duration_s=0.0,
    )
