"""The last three minutes of PLC samples, and who wants to hear of new ones."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable

from protocol.codes import HeaderFlag
from protocol.messages import State
from server.link.contracts import PlcSample
from server.listeners import Listeners

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

    def extend(self, samples: Iterable[PlcSample]) -> None:
        """Keep new samples and call the listeners."""
        for sample in samples:
            self._samples.append(sample)
            self.listeners.call(sample)

    def since(self, t_mono_ns: int) -> list[PlcSample]:
        """All samples received after this time."""
        kept = list(self._samples)
        return kept[bisect_right(kept, t_mono_ns, key=lambda sample: sample.t_mono_ns) :]

    def subscribe(self, callback: SampleCallback) -> Callable[[], None]:
        """Call back for every new sample; the answer ends it."""
        return self.listeners.add(callback)
