"""Effects of stage structure: their parameters, bounds and priors, and what distinguishes each."""

from machine.effects.spec import Direction, Effect, Parameter, Prior, QuantityChoice

# fmt: off
EFFECTS: tuple[Effect, ...] = (
    # gravity_sag: boom and mounting bend under gravity behind the encoder.
    Effect(name="gravity_sag", stage="structure", scope="joint",
        parameters=(
            Parameter(name="compliance_rad_nm", unit="rad/(N m)", plausible_min=0.0, plausible_max=1e-05,
                start_value=1e-06,
                prior=Prior("half_normal", 1e-06), meaning="bending at the joint about its axis per torque of gravity",
                light_arm_max=0.01),
        ),
        looks_like="the tip hangs lower, more so at long reach; the same from both sides of approach",
        distinguished_by="encoder_bias is the same in every posture; base_compliance turns the whole arm about the "
            "base; in one family of poses sag and bias are equal: vary the reach",
        source="torsion springs 0.4 to 1.5e6 N m/rad per joint; 25 to 45 mm at full reach", prior_probability=0.3),
    # link_length_error: a link is longer or shorter than the drawing.
    Effect(name="link_length_error", stage="structure", scope="joint",
        parameters=(
            Parameter(name="error_m", unit="m", plausible_min=-0.2, plausible_max=0.2, start_value=0.005,
                prior=Prior("normal", 0.005),
                meaning="added to the DH length a or d"),
        ),
        quantity_choice=QuantityChoice("of", ("a", "d"), "which DH length"),
        looks_like="the tip errs by a constant along that link's direction",
        distinguished_by="encoder_bias errs across the link; a along x of one link and d along z of the next may be "
            "the same direction",
        source="welded booms: sd 3 to 4 mm", prior_probability=0.3),
    # base_tilt: the base stands out of level.
    Effect(name="base_tilt", stage="structure", scope="machine",
        parameters=(
            Parameter(name="tilt_rad", unit="rad", plausible_min=0.0, plausible_max=0.1, start_value=0.005,
                prior=Prior("half_normal", 0.01),
                meaning="rotation of the base about the axis"),
        ),
        direction=Direction("axis", (1.0, 0.0, 0.0), "base", n_fitted_components=2),
        looks_like="the whole arm is turned about the base: height error in proportion to reach, once a turn of slew",
        distinguished_by="without an outside frame that is level it cannot be seen; base_compliance changes with the "
            "load",
        source="set-up of a crane on a vehicle or floor", prior_probability=0.3),
    # base_compliance: the vehicle or floor gives way under the arm's moment.
    Effect(name="base_compliance", stage="structure", scope="machine",
        parameters=(
            Parameter(name="compliance_rad_nm", unit="rad/(N m)", plausible_min=0.0, plausible_max=1e-05,
                start_value=2e-07,
                prior=Prior("half_normal", 3e-07),
                meaning="rotation of the base per moment of gravity about the base's origin", light_arm_max=0.01),
        ),
        looks_like="the whole arm leans towards its load, wherever slew points",
        distinguished_by="base_tilt stays fixed in the base; gravity_sag of lift bends about the lift axis, not "
            "about the base",
        source="stabiliser legs and sub-frame"),
    # payload_error: the load at the tip is not the one in the machine file.
    Effect(name="payload_error", stage="structure", scope="machine",
        parameters=(
            Parameter(name="mass_kg", unit="kg", plausible_min=-200.0, plausible_max=500.0, start_value=50.0,
                prior=Prior("normal", 50.0),
                meaning="carried at the tcp beyond the machine file's masses"),
        ),
        looks_like="all that depends on gravity's torque grows together: sag, leakage, droop",
        distinguished_by="by itself invisible on a rigid arm; a single gravity_sag changes one joint only",
        source="contract of the gap diagnosis"),
    # link_flexibility: the boom oscillates behind the encoder after each change of speed.
    Effect(name="link_flexibility", stage="structure", scope="joint",
        parameters=(
            Parameter(name="gain", unit="1", plausible_min=0.0, plausible_max=2.0, start_value=0.3,
                prior=Prior("half_normal", 0.3),
                meaning="deflection's drive per acceleration of the joint"),
            Parameter(name="frequency_hz", unit="Hz", plausible_min=0.3, plausible_max=20.0, start_value=2.5,
                prior=Prior("log_uniform"),
                meaning="of the free oscillation", neutral_value=2.5, role="shape"),
            Parameter(name="damping", unit="1", plausible_min=0.005, plausible_max=0.5, start_value=0.04,
                prior=Prior("log_uniform"),
                meaning="ratio to critical", neutral_value=0.04, role="shape"),
        ),
        looks_like="a decaying oscillation of the tip that the encoder does not show",
        distinguished_by="backlash does not ring; clock errors follow speed, this one follows acceleration",
        source="first mode 2.3 to 3.5 Hz at full reach, damping 3 to 5 %", prior_probability=0.05),
    # joint_axis_tilt: a joint's axis is not where the drawing has it.
    Effect(name="joint_axis_tilt", stage="structure", scope="joint",
        parameters=(
            Parameter(name="tilt_rad", unit="rad", plausible_min=-0.1, plausible_max=0.1, start_value=0.005,
                prior=Prior("normal", 0.005),
                meaning="of the joint's axis about x or y of its frame"),
        ),
        quantity_choice=QuantityChoice("about", ("x", "y"), "which axis of the joint's own frame, before its motion"),
        looks_like="the tip moves on a tilted circle when this joint turns",
        distinguished_by="base_tilt is the same for all joints; encoder_bias stays in the joint's plane",
        source="Hayati 1983 for near-parallel axes", prior_probability=0.15),
)
# fmt: on
