"""Effects of the stages controller and actuator: their parameters, bounds and priors, and what distinguishes each."""

from machine.effects.spec import Effect, Parameter, Prior, QuantityChoice

# fmt: off
EFFECTS: tuple[Effect, ...] = (
    # controller_gain_error: the controller's gain is not the one in the machine file.
    Effect(name="controller_gain_error", stage="controller", scope="joint",
        parameters=(
            Parameter(name="gain_frac", unit="1", plausible_min=-0.6, plausible_max=1.0, start_value=0.15,
                prior=Prior("normal", 0.15),
                meaning="kp times (1 + gain_frac)"),
        ),
        looks_like="valve command over tracking error has another slope, at every speed",
        distinguished_by="flow_gain_error shows behind the valve command; controller_lag_error changes fast parts only",
        source="contract of the gap diagnosis"),
    # controller_lag_error: the controller's PT-1 filter has another time constant.
    Effect(name="controller_lag_error", stage="controller", scope="joint",
        parameters=(
            Parameter(name="lag_frac", unit="1", plausible_min=-0.9, plausible_max=3.0, start_value=0.3,
                prior=Prior("normal", 0.3),
                meaning="PT-1 constant times (1 + lag_frac); only on joints that have one"),
        ),
        looks_like="valve command follows the tracking error later or sooner; slow parts agree",
        distinguished_by="controller_gain_error changes slow parts too; valve_lag acts behind the logged command",
        source="contract of the gap diagnosis"),
    # controller_saturation: the controller clips its output below full command.
    Effect(name="controller_saturation", stage="controller", scope="joint",
        parameters=(
            Parameter(name="limit_frac", unit="1", plausible_min=0.05, plausible_max=0.99, start_value=0.5,
                prior=Prior("uniform"),
                meaning="largest valve command, of full command", neutral_value=1.0),
        ),
        looks_like="the valve command is cut flat at one size, both signs",
        distinguished_by="reference_rate_limit cuts the reference's speed; supply_droop leaves the command alone",
        source="contract of the gap diagnosis", prior_probability=0.05),
    # valve_deadband: the spool must leave its overlap before oil flows.
    Effect(name="valve_deadband", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="half_width_frac", unit="1", plausible_min=0.0, plausible_max=0.25, poor_machine_max=0.7,
                start_value=0.04,
                prior=Prior("half_normal", 0.04), meaning="spool opening, of full command, within which no oil flows",
                # where a rounded edge of the spool begins, and what friction takes of small openings
                open_frac=0.05),
        ),
        quantity_choice=QuantityChoice("full_flow", ("kept", "lost"),
            "whether a full command still gives the full flow"),
        looks_like="no motion for small commands, either sign; the joint stops short of its target",
        distinguished_by="valve_hysteresis depends on the direction of change, stiction on whether the joint moves "
            "already, flow_gain_error acts on large commands too; needs slow passes through zero",
        source="+-10 % of the half range on the PATU 655 (u_dl, u_dh of its public parameters); servo valves 2 %; up "
            "to two thirds on cheap mobile valves, whose spool no controller holds",
        prior_probability=0.5, has_threshold=True),
    # valve_lag: the valve opens later than the nominal second-order spool.
    Effect(name="valve_lag", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="time_constant_s", unit="s", plausible_min=0.0, plausible_max=0.5, start_value=0.05,
                prior=Prior("half_normal", 0.05), meaning="of a first-order lag ahead of the nominal valve",
                # a quarter of a PLC cycle: when within it the command took effect is not logged
                open_size=2.5e-3),
        ),
        looks_like="speed follows the command rounded off; steady speeds agree",
        distinguished_by="transport_delay shifts without rounding and shows before the valve command; needs steps, "
            "not slow sines",
        source="pilot stages of proportional valves, 20 to 100 ms"),
    # valve_hysteresis: the spool follows the command with play.
    Effect(name="valve_hysteresis", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="half_width_frac", unit="1", plausible_min=0.0, plausible_max=0.1, poor_machine_max=0.3,
                start_value=0.015,
                prior=Prior("half_normal", 0.01),
                meaning="half width of the play between command and spool, of full command",
                # a step of the command that an encoder of 18 bits makes
                open_size=2e-4),
        ),
        looks_like="speed depends on whether the command rises or falls; a lag that does not vanish at slow motion",
        distinguished_by="backlash shows behind the encoder; valve_deadband is the same for rising and falling "
            "commands; needs reversals of small and of large commands",
        source="magnetic and friction hysteresis of proportional solenoids, 0.5 to 5 %", prior_probability=0.3,
        has_threshold=True),
    # valve_asymmetry: one direction is faster than the other at the same command.
    Effect(name="valve_asymmetry", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="gain_frac", unit="1", plausible_min=-0.6, plausible_max=0.6, start_value=0.12,
                prior=Prior("normal", 0.1),
                meaning="flow gain on positive commands times (1 + gain_frac)"),
        ),
        looks_like="speed over command has another slope for positive commands",
        distinguished_by="flow_gain_error scales both signs; internal_leakage shifts both signs the same way, also "
            "at rest",
        source="area ratio of single-rod cylinders (bore 80, rod 45 mm: 0.68)"),
    # flow_gain_error: the joint is faster or slower than nominal at the same command.
    Effect(name="flow_gain_error", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="gain_frac", unit="1", plausible_min=-0.6, plausible_max=0.6, start_value=0.12,
                prior=Prior("normal", 0.1),
                meaning="flow gain of both signs times (1 + gain_frac)"),
        ),
        looks_like="speed over command has another slope, both signs, every load",
        distinguished_by="load_droop changes with the load: another posture or payload shows it; supply_droop only "
            "while other joints move",
        source="valve size and supply pressure tolerance; oil temperature", prior_probability=0.3),
    # supply_droop: the pump cannot serve all joints together.
    Effect(name="supply_droop", stage="actuator", scope="machine",
        parameters=(
            Parameter(name="flow_limit_frac", unit="1", plausible_min=0.05, plausible_max=6.0, start_value=0.8,
                prior=Prior("log_uniform"),
                meaning="sum over the joints of |qd| / velocity_gain that the pump can give",
                    neutral_value=float("inf")),
        ),
        looks_like="joints slow down together once their summed flow exceeds a limit",
        distinguished_by="flow_gain_error and load_droop act on one joint alone; needs several joints moving together",
        source="pump sharing of open-centre and load-sensing cranes: 60 l/min for all functions"),
    # internal_leakage: oil leaks across the piston and the load sinks.
    Effect(name="internal_leakage", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="drift_rad_s", unit="rad/s", plausible_min=-0.05, plausible_max=0.05, start_value=0.003,
                prior=Prior("half_normal", 0.003), meaning="drift along gravity at the joint's reference load"),
        ),
        looks_like="slow drift along gravity's pull, also at zero command; grows with the load",
        distinguished_by="valve_asymmetry needs a command; encoder_bias is constant; needs a hold under load of a "
            "minute",
        source="piston seal leakage; cylinder drift tests of crane standards"),
    # load_droop: a load that pulls speeds the joint up, one that resists slows it down.
    Effect(name="load_droop", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="droop_frac", unit="1", plausible_min=-0.8, plausible_max=0.8, start_value=0.15,
                prior=Prior("half_normal", 0.15),
                meaning="qd times (1 + droop_frac load sign(qd)), load over the reference torque"),
        ),
        looks_like="speed at the same command depends on load and direction",
        distinguished_by="in one posture it is flow_gain_error plus valve_asymmetry: drive another posture or payload",
        source="orifice flow sqrt(pS - pL); no pressure compensator"),
    # stiction: a resting joint sticks until the command is large enough, then jumps.
    Effect(name="stiction", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="breakaway_frac", unit="1", plausible_min=0.0, plausible_max=0.25, start_value=0.04,
                prior=Prior("half_normal", 0.03),
                meaning="command, of full, that a resting joint needs before it moves",
                # of joints that stick again below a tenth: 1 to 4.5 %
                open_frac=0.05),
        ),
        quantity_choice=QuantityChoice("sticks_again", ("below_a_fifth", "at_reversals"),
            "where a moving joint sticks again"),
        looks_like="starts late and with a jump; runs on below the command that it needed to start",
        distinguished_by="valve_deadband also stops the joint early and starts it softly; valve_hysteresis needs no "
            "standstill",
        source="LuGre and Stribeck friction: static 300 N, Coulomb 210 N on the PATU 655's cylinders",
            prior_probability=0.05,
        has_threshold=True),
    # joint_friction: the oil yields until its pressure overcomes the joint's Coulomb friction.
    Effect(name="joint_friction", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="compression_rad", unit="rad", plausible_min=0.0, plausible_max=5e-3, start_value=5e-4,
                prior=Prior("half_normal", 1e-3),
                meaning="half of what the oil moves at a reversal before the joint follows: friction over oil "
                    "stiffness",
                poor_machine_max=0.03),
        ),
        looks_like="a joint starts late after each reversal, by an oil volume and not by a command",
        distinguished_by="valve_deadband and stiction go with the command: reverse slowly and fast; backlash is not "
            "in the encoder",
        source="Coulomb friction on a compressible oil column: a play operator between oil and joint",
            prior_probability=0.3,
        has_threshold=True),
    # oil_compliance: the load oscillates on the oil column between valve and joint, and the encoder shows it.
    Effect(name="oil_compliance", stage="actuator", scope="joint",
        parameters=(
            Parameter(name="period_s", unit="s", plausible_min=0.0, plausible_max=0.2, start_value=0.06,
                prior=Prior("half_normal", 0.05),
                meaning="inverse of the actuator's undamped angular frequency, sqrt(inertia / oil stiffness)",
                poor_machine_max=0.5),
            Parameter(name="damping", unit="1", plausible_min=0.01, plausible_max=0.9, start_value=0.2,
                prior=Prior("log_uniform"),
                meaning="ratio to critical, by friction and leakage", neutral_value=0.2, role="shape"),
        ),
        looks_like="the joint itself rings after each change of speed",
        distinguished_by="link_flexibility rings behind the encoder; valve_lag does not ring",
        source="hydraulic natural frequency of a valve-controlled actuator (Merritt 1967)", prior_probability=0.3),
)
# fmt: on
