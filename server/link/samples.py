"""The last three minutes of PLC samples, and who wants to hear of new ones."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from protocol.codes import HeaderFlag
from protocol.gate import Refusal
from protocol.messages import Knot, State, pad_to_eight_axes
from server.link.contracts import PlcSample
from server.link.errors import LinkRefusedError
from server.listeners import Listeners
from server.motion.contracts import JointTrajectory

_KEPT = 180 * 100  # three minutes at 100 Hz: the longest calibration path fits

SampleCallback = Callable[[PlcSample], None]


# A PLC state as the server's sample: joints in use only, names instead of numbers.


def sample_of(state: State, t_mono_ns: int, joints: int) -> PlcSample:
    """The sample of one received state."""
    return PlcSample(
        t_plc_ns=state.t_send_ns,
        t_mono_ns=t_mono_ns,
        seq=state.seq,
        q_rad=state.q[:joints],
        qd_rad_s=state.qd[:joints],
        q_ref_rad=state.q_ref[:joints],
        qd_ref_rad_s=state.qd_ref[:joints],
        valve_frac=state.valve_cmd[:joints],
        pressure_a_pa=state.p_a[:joints],
        pressure_b_pa=state.p_b[:joints],
        pressure_supply_pa=state.p_supply,
        oil_temperature_c=state.t_oil,
        plc_state=state.plc_state.name,
        traj_id=state.traj_id,
        knot_playing=state.knot_playing,
        t_play_ns=state.t_play_ns,
        buffer_us=state.buffer_us,
        underruns=state.underruns,
        fault_bits=state.fault_bits,
        reject_code=state.reject_code,
        simulation=HeaderFlag.SIMULATION in state.flags,
        dry_run=HeaderFlag.DRY_RUN in state.flags,
    )


class SampleRing:
    """Samples in the order of their receive time."""

    def __init__(self) -> None:
        self._samples: deque[PlcSample] = deque(maxlen=_KEPT)
        self.listeners = Listeners[[PlcSample]]("a PLC sample")

    @property
    def latest(self) -> PlcSample | None:
        """The newest sample."""
        return self._samples[-1] if self._samples else None

    def add_samples(self, samples: Iterable[PlcSample]) -> None:
        """Keep new samples and call the listeners."""
        for sample in samples:
            self._samples.append(sample)
            self.listeners.call(sample)

    def samples_since(self, t_mono_ns: int) -> list[PlcSample]:
        """All samples received after this time."""
        kept = list(self._samples)
        return kept[bisect_right(kept, t_mono_ns, key=lambda sample: sample.t_mono_ns) :]

    def subscribe(self, callback: SampleCallback) -> Callable[[], None]:
        """Call back for every new sample; the answer ends it."""
        return self.listeners.add(callback)


# A planned trajectory as the knots of a run request.

_REFUSALS_SHOWN = 3
KnotTuple = tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]]


def knots_from(tuples: Iterable[KnotTuple]) -> tuple[Knot, ...]:
    """The knots of a request as the link takes them."""
    return tuple(
        Knot(t, pad_to_eight_axes(q), pad_to_eight_axes(qd), pad_to_eight_axes(qdd)) for t, q, qd, qdd in tuples
    )


def refusals_text(refusals: Sequence[Refusal]) -> str:
    """The motion gate's reasons in one line: the first three, and how many more."""
    shown = "; ".join(refusal.as_line for refusal in refusals[:_REFUSALS_SHOWN])
    more = len(refusals) - _REFUSALS_SHOWN
    return f"motion gate: {shown}" + (f"; and {more} more" if more > 0 else "")


def knots_of(trajectory: JointTrajectory, joints: int) -> tuple[KnotTuple, ...]:
    """The trajectory's own knots, times in whole nanoseconds; nothing is resampled.

    Raises: LinkRefusedError: shapes do not fit the machine.
    """
    n = len(trajectory.t_s)
    for name, array in (("q", trajectory.q), ("qd", trajectory.qd), ("qdd", trajectory.qdd)):
        if array.shape != (n, joints):
            raise LinkRefusedError(f"trajectory.{name}: shape {array.shape}, must be {(n, joints)} (knots, joints)")
    times_ns = [round(float(t) * 1e9) for t in trajectory.t_s]
    rows = zip(times_ns, trajectory.q.tolist(), trajectory.qd.tolist(), trajectory.qdd.tolist(), strict=True)
    return tuple((t, tuple(q), tuple(qd), tuple(qdd)) for t, q, qd, qdd in rows)


# Whether the machine stood still over the last samples of the PLC.


def stood_still(
    samples: Sequence[PlcSample], window_s: float, moved_max_rad_s: float, referenced_max_rad_s: float
) -> bool:
    """Whether encoders moved less than the first limit over at least 80 % of the window, and the reference rests.

    Args: moved_max_rad_s: way of the joint that moved most, over the time; referenced_max_rad_s: of the newest
        sample's reference speeds.
    """
    if len(samples) < 2:
        return False
    span_s = (samples[-1].t_plc_ns - samples[0].t_plc_ns) * 1e-9
    if span_s < 0.8 * window_s:
        return False
    qs = np.array([sample.q_rad for sample in samples])
    moved = float(np.max(qs.max(axis=0) - qs.min(axis=0)))
    referenced = max(abs(value) for value in samples[-1].qd_ref_rad_s)
    return moved / span_s < moved_max_rad_s and referenced < referenced_max_rad_s
