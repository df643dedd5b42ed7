"""What is true of one simulated machine's mechanics and hydraulics: plain numbers, never shown to the server."""

from dataclasses import dataclass

from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class KinematicTruth:
    """The true classic-DH table (6 rows) and how the play of the joints lies at the start."""

    a_m: Array
    d_m: Array
    alpha_rad: Array
    theta_zero_rad: Array  # theta offset plus this machine's joint zero error
    T_flange_tcp: Array
    q_stop_low_rad: Array  # mechanical end stops, a little outside the file's joint limits
    q_stop_high_rad: Array
    encoder_counts_rev: Array
    backlash_rad: Array  # peak to peak, on the output side; 0 = none
    play_start_frac: Array  # -1..1: where the output lies inside its play at the start


@dataclass(frozen=True, slots=True)
class InertiaTruth:
    """Masses of the six links in their DH link frames, rotor inertias and gravity."""

    gravity_base_m_s2: Array
    mass_kg: Array  # (6,)
    com_m: Array  # (6, 3), in the link's DH frame
    inertia_com_kg_m2: Array  # (6, 3, 3), about the centre of mass, axes of the link's DH frame
    armature_kg_m2: Array  # (6,), about the joint axis, before the flexible joint


@dataclass(frozen=True, slots=True)
class FlexTruth:
    """Five passive torsion joints: lift vertical, lift lateral, tilt vertical, tilt lateral, wrist mount."""

    stiffness_nm_rad: Array  # (5,)
    damping_ratio: Array  # (5,), of the spring with everything outboard of it


@dataclass(frozen=True, slots=True)
class ValveTruth:
    """Six servo valves; fractions of full command."""

    frequency_hz: Array
    damping: Array
    rate_limit_1_s: Array
    dead_band_frac: Array  # half width
    hysteresis_frac: Array  # half width of the play on the command
    flow_gain_m3_s_sqrt_pa: Array  # per edge: q = gain * s * sqrt(dp)


@dataclass(frozen=True, slots=True)
class ActuatorTruth:
    """Cylinders and rotary actuators: area [m2 or m3/rad], position y(q) [m or rad] and lever dy/dq [m/rad or 1]."""

    area_a: Array  # (6,)
    area_b: Array
    dead_volume_a_m3: Array
    dead_volume_b_m3: Array
    stroke: Array  # full stroke [m or rad]
    leakage_m3_s_pa: Array
    bulk_modulus_pa: float
    laminar_pa: float
    table_q0_rad: Array  # (6,) first angle of the tables
    table_step_rad: Array  # (6,)
    table_y: Array  # (6, n): travel from the retracted end
    table_lever: Array  # (6, n)


@dataclass(frozen=True, slots=True)
class SupplyTruth:
    """Pump, small accumulator and tank."""

    pressure_pa: float
    tank_pa: float
    ripple_pa: float
    ripple_hz: float
    ripple_phase_rad: float
    flow_max_m3_s: float
    droop_pa: float  # pressure below the set pressure at which the pump gives its full flow
    accumulator_m3_pa: float
    oil_temperature_c: float


@dataclass(frozen=True, slots=True)
class FrictionTruth:
    """LuGre friction of the six actuators, in actuator coordinates (N and m/s, or N m and rad/s)."""

    coulomb: Array
    static: Array
    viscous: Array
    stribeck: Array
    bristle_stiffness: Array
    bristle_damping: Array


@dataclass(frozen=True, slots=True)
class PlantTruth:
    """One machine. `rigid` makes it the nominal model: velocity actuators, no structure, no friction, no oil."""

    rigid: bool
    velocity_gain_rad_s: Array  # used by the rigid machine only
    kinematics: KinematicTruth
    inertia: InertiaTruth
    flex: FlexTruth
    valve: ValveTruth
    actuator: ActuatorTruth
    supply: SupplyTruth
    friction: FrictionTruth
