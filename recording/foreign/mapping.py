"""The mapping file: assigns topics or columns to signals where guessing by name is not wanted."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from recording.errors import RecordingError
from recording.files import read_text

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
CommandKind = Literal["velocity", "position", "effort", "valve"]
ColumnSignal = Literal["time", "q", "q_ref", "qd_ref", "u", "x", "y", "z", "ignored"]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class RosTracker(_Section):
    """A tracked point: a topic of poses or points, or a frame of /tf; `joint`: the link it is fixed to, from 1."""

    topic: str = ""
    frame: str = ""
    point: str
    joint: int | None = None


class RosTopics(_Section):
    """Topics by what they are; empty: by type and name. `encoder_joints`: of joint states that name no joints."""

    encoders: str = ""
    encoder_joints: list[str] = []
    reference: str = ""
    command: str = ""
    command_kind: CommandKind | None = None
    command_joints: list[str] = []
    tracker: list[RosTracker] = []


class ColumnMapping(_Section):
    """One column of a table: what it is, of which joint (from 1) or point, in which unit."""

    name: str
    signal: ColumnSignal
    joint: int | None = Field(default=None, ge=1)
    point: str = ""
    unit: str = ""


class Actuator(_Section):
    """How the joints are driven, for the nominal machine: see `machine_file.drive_model`."""

    kind: CommandKind | None = None
    velocity_max: Positive | None = None
    bandwidth_hz: Positive | None = None
    velocity_bandwidth_hz: Positive | None = None
    damping: Positive | None = None


class UrdfChain(_Section):
    """The arm's two ends in the URDF; empty: the root, and the link that the last recorded joint moves."""

    base_link: str = ""
    tip_link: str = ""


class TimeWindow(_Section):
    """The stretch to be read [s] since the first stamp."""

    from_s: float = 0.0
    to_s: float | None = None


class Mapping(_Section):
    """The whole file; every section is optional.

    `joint_names`: the log's name of a joint -> the URDF's; `rate_hz`: of a table without a column of times.
    """

    joints: list[str] = []
    joint_names: dict[str, str] = {}
    rate_hz: Positive | None = None
    ros: RosTopics = RosTopics()
    column: list[ColumnMapping] = []
    actuator: Actuator = Actuator()
    urdf: UrdfChain = UrdfChain()
    window: TimeWindow = TimeWindow()


def read_mapping(path: Path) -> Mapping:
    """The mapping in a TOML file.

    Raises: RecordingError: not there, not TOML, or a key or value that does not belong there; names it.
    """
    try:
        data = tomllib.loads(read_text(path))
    except OSError as error:
        raise RecordingError(f"mapping file {path} cannot be read: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise RecordingError(f"mapping file {path} is not TOML: {error}") from error
    try:
        return Mapping.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise RecordingError(f"mapping file {path}: {place}: {first['msg']}; see docs/other-logs.md") from error
