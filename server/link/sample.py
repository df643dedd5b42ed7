"""A PLC state as the server's sample: joints in use only, names instead of numbers."""

from protocol.codes import HeaderFlag
from protocol.messages import State
from server.link.contracts import PlcSample


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
