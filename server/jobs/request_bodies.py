"""What a client sends to start a job: one strict model per kind of job, units in every name."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from server.motion.jog import JogAxis


class JobRequest(BaseModel):
    """Body of a job request without parameters of its own: exact types, nothing undeclared, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    owner: str | None = Field(
        default=None, min_length=1, max_length=64, description="shown with the job; else the owner of the lease"
    )


class LookRequest(JobRequest):
    """Look: pose error between tool and goal."""

    kind: Literal["look"]


class OrientRequest(JobRequest):
    """Turn the tool to the OOI (orientation steps)."""

    kind: Literal["orient"]


class CalibrateRequest(JobRequest):
    """Drive the calibration path and match trajectories."""

    kind: Literal["calibrate"]


class PreviewRequest(JobRequest):
    """Plan one move from the last look; nothing moves."""

    kind: Literal["preview"]


class ExecuteRequest(JobRequest):
    """Execute the previewed plan of that hash."""

    kind: Literal["execute"]
    plan_hash: str = Field(min_length=16, max_length=16, pattern="^[0-9a-f]{16}$")


class PositionRequest(JobRequest):
    """The whole loop."""

    kind: Literal["position"]
    method: Literal["ours", "paper"] = "ours"
    recalibrate: bool = True


class PatternRequest(JobRequest):
    """The whole loop at each of the chosen marks in turn, with a return to the start in between."""

    kind: Literal["pattern"]
    target_ids: list[Annotated[int, Field(ge=1, le=2**53)]] = Field(
        min_length=1, max_length=12, description="marks of the last search (POST /v1/target/marks), in order"
    )


class LineRequest(JobRequest):
    """The paper's line-equation method: circle while looking, one move; its servo variant; or our fit."""

    kind: Literal["line"]
    variant: Literal["paper", "paper servo", "fit", "fit, OOI axes"] = "fit"


class ServoRequest(JobRequest):
    """The last way while looking (closed loop); needs `[position] closed_loop = true`."""

    kind: Literal["servo"]


class PlanIdentifyRequest(JobRequest):
    """Plan the drive that shows what this machine's model leaves out: look, and move nothing. `identify` drives it."""

    kind: Literal["plan_identify"]
    minutes: float = Field(
        default=6.0, ge=1.5, le=6.0, description="approximate duration; shorter drives identify less"
    )
    wall_free: bool = Field(
        default=False, description="confirms that no wall is in reach; required where none is measured"
    )
    resume: bool = Field(default=False, description="only the remaining parts of a paused drive")


class IdentifyRequest(JobRequest):
    """Drive the planned identification of that hash, record it, and diagnose it with its earlier parts."""

    kind: Literal["identify"]
    plan_hash: str = Field(min_length=16, max_length=16, pattern="^[0-9a-f]{16}$")


class RetractRequest(JobRequest):
    """Back away from the wall along the tool's axis."""

    kind: Literal["retract"]
    distance_mm: float = Field(default=300.0, ge=10.0, le=1000.0)


class JogRequest(JobRequest):
    """Move one joint, or along (x, y, z) or about (rx, ry, rz) one axis of the tool, slowly: over /v1/hold only."""

    kind: Literal["jog"]
    axis: JogAxis = Field(description="`joint_1` is the first from the base; the tool's axes are those of the tcp")
    direction: Literal[-1, 1]


class ReturnRequest(JobRequest):
    """Back to where the last run began."""

    kind: Literal["return"]


class ParkRequest(JobRequest):
    """Fold the machine. Refused (`no_wall`) before the first look for a wall, but for `wall_free`."""

    kind: Literal["park"]
    wall_free: bool = Field(
        default=False, description="confirms that no wall is in reach; required before the first look"
    )
