"""The experiment that a finished diagnosis proposes, read from its answer; what the link cannot drive is refused."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from mcap.records import Attachment
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from recording.errors import RecordingError
from recording.files import read_text, text_of
from recording.reader import RecordStream
from recording.run import SegmentKind
from server.calibration.contracts import Array
from server.errors import JobFailedError

KNOTS_MAX = 20_000
NOT_DRIVABLE = "experiment_not_drivable"
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]
Angles = Annotated[list[Angle], Field(min_length=1, max_length=16)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class MotionProposal(_Strict):
    """A reference by knots of the joints (1-based) that move; the others stay where they start."""

    kind: Literal["motion"]
    name: str
    segment_kind: SegmentKind
    start_rad: Angles
    t_knot_s: float = Field(gt=0.0, le=10.0)
    joints: list[Annotated[int, Field(ge=1, le=16)]] = Field(min_length=1, max_length=16)
    q_rad: list[Angles] = Field(min_length=3, max_length=KNOTS_MAX)

    def course(self) -> Array:
        """Knots (k, n) of all joints. Raises: ValueError: rows that do not fit."""
        knots = np.tile(np.array(self.start_rad, dtype=float), (len(self.q_rad), 1))
        knots[:, np.array(self.joints, dtype=int) - 1] = np.array(self.q_rad, dtype=float)
        return knots


class LooksProposal(_Strict):
    """Encoder readings to come to rest in, each from below, and to look from."""

    kind: Literal["looks"]
    name: str
    q_rad: list[Angles] = Field(min_length=1, max_length=200)
    look_s: float = Field(gt=0.0, le=600.0)
    from_below: bool


Proposal = Annotated[MotionProposal | LooksProposal, Field(discriminator="kind")]
PROPOSAL: TypeAdapter[MotionProposal | LooksProposal] = TypeAdapter(Proposal)


def proposal_of(answer: dict[str, Any], joints: int) -> MotionProposal | LooksProposal:
    """What the answer of a diagnosis proposes, for a machine with that many joints.

    Raises: JobFailedError: it proposes nothing; or what it proposes is nothing that this link can drive.
    """
    following = answer.get("next_experiment") or {}
    what = following.get("what")
    if not what:
        why = following.get("why") or "its answer names none"
        raise JobFailedError(f"the diagnosis proposes no experiment: {why}", "no_experiment")
    description = following.get("execute")
    if description is None:
        needed = following.get("signal") or following.get("why") or "it is to be done by hand"
        raise JobFailedError(f"'{what}' cannot be driven over the link; {needed}", NOT_DRIVABLE)
    found = _parsed(description, what)
    rows = [found.start_rad] if isinstance(found, MotionProposal) else found.q_rad
    if any(len(row) != joints for row in rows):
        raise JobFailedError(
            f"'{what}' is for {len(rows[0])} joints, this machine has {joints}; diagnose a recording of this machine",
            "other_machine",
        )
    return found


def _parsed(description: object, what: str) -> MotionProposal | LooksProposal:
    kind = description.get("kind") if isinstance(description, dict) else None
    if kind not in ("motion", "looks"):
        raise JobFailedError(
            f"'{what}' is of kind {str(kind)[:40]!r}: the link drives references of the joints and looks from "
            "postures, no valve or pump directly; do it at the PLC, record it, and diagnose both recordings",
            NOT_DRIVABLE,
        )
    try:
        found = PROPOSAL.validate_python(description)
        if isinstance(found, MotionProposal):
            found.course()
    except (ValidationError, ValueError, IndexError) as error:
        raise JobFailedError(f"'{what}' cannot be read as an experiment: {str(error)[:200]}", NOT_DRIVABLE) from error
    return found


def separated_by(answer: dict[str, Any]) -> tuple[str, ...]:
    """The names that the experiment is to tell apart, with their joints."""
    pairs = (answer.get("next_experiment") or {}).get("separates") or []
    return tuple(
        f"{one.get('name')}" + (f" on joint {one['joint']}" if one.get("joint") is not None else "") for one in pairs
    )


def machine_text_in(recording: Path) -> str:
    """The machine file inside a recording; the heads of an MCAP file are read only.

    Raises: JobFailedError: it cannot be read.
    """
    try:
        if recording.is_dir():
            return read_text(recording / "machine.toml")
        for record in RecordStream(recording):
            if isinstance(record, Attachment) and record.name == "machine.toml":
                return text_of(record.data)
    except (OSError, RecordingError) as error:
        raise JobFailedError(f"{recording.name}: its machine file cannot be read: {error}", "other_machine") from error
    return ""


def require_same_machine(recordings: tuple[Path, ...], machine_text: str) -> None:
    """Raises: JobFailedError: a recording of another machine file; both could not be diagnosed together either."""
    for one in recordings:
        if machine_text_in(one).strip() != machine_text.strip():
            raise JobFailedError(
                f"{one.name} was recorded with another machine file than this server's; record again with this one",
                "other_machine",
            )
