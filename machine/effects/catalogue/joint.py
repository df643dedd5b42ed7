"""Effects of stage joint: their parameters, bounds and priors, and what distinguishes each."""

from machine.effects.spec import Effect, Parameter, Prior

# fmt: off
EFFECTS: tuple[Effect, ...] = (
    # backlash: the link lags its encoder by the gear's play.
    Effect(name="backlash", stage="joint", scope="joint",
        parameters=(
            Parameter(name="width_rad", unit="rad", plausible_min=0.0, plausible_max=0.05, start_value=0.003,
                prior=Prior("half_normal", 0.002),
                meaning="peak to peak, behind the encoder"),
        ),
        looks_like="after each reversal the link stands still while the encoder moves; two values of the link for "
            "one encoder angle",
        distinguished_by="gravity_sag is the same from both sides; valve_hysteresis shows in the encoder; needs "
            "approaches from both sides",
        source="slew rack and pinion +-0.75 mrad, helical wrist actuators 0.05 to 0.5 deg", has_threshold=True),
    # encoder_bias: the encoder's zero is off.
    Effect(name="encoder_bias", stage="joint", scope="joint",
        parameters=(
            Parameter(name="bias_rad", unit="rad", plausible_min=-0.3, plausible_max=0.3, start_value=0.01,
                prior=Prior("normal", 0.01),
                meaning="encoder = true + bias_rad"),
        ),
        looks_like="a constant joint error: the tip errs along one direction that turns with the arm",
        distinguished_by="gravity_sag changes with posture; hand_eye_rotation turns with the wrist only; "
            "encoder_scale grows with the angle",
        source="joint zeros sd 0.25 deg after commissioning", prior_probability=0.5),
    # encoder_scale: the encoder counts too many or too few per turn.
    Effect(name="encoder_scale", stage="joint", scope="joint",
        parameters=(
            Parameter(name="scale_frac", unit="1", plausible_min=-0.1, plausible_max=0.1, start_value=0.01,
                prior=Prior("normal", 0.01),
                meaning="encoder = true (1 + scale_frac)"),
        ),
        looks_like="a joint error in proportion to the joint's angle",
        distinguished_by="encoder_bias is constant; needs the joint's whole range, measured from outside",
        source="wrong gear ratio or linear sensor calibration", prior_probability=0.05),
    # encoder_eccentricity: the encoder's disc sits off its axis.
    Effect(name="encoder_eccentricity", stage="joint", scope="joint",
        parameters=(
            Parameter(name="amplitude_rad", unit="rad", plausible_min=0.0, plausible_max=0.03, start_value=0.002,
                prior=Prior("half_normal", 0.002), meaning="of encoder = true + amplitude sin(order true + phase)"),
            Parameter(name="order", unit="1", plausible_min=1.0, plausible_max=4.0, start_value=1.0,
                prior=Prior("uniform"),
                meaning="whole waves per turn", neutral_value=1.0, role="shape", is_integer=True),
            Parameter(name="phase_rad", unit="rad", plausible_min=-3.2, plausible_max=3.2, start_value=0.7,
                prior=Prior("uniform"),
                meaning="at true angle 0", role="shape"),
        ),
        looks_like="a joint error that waves with the angle, once or twice a turn",
        distinguished_by="gravity_sag also waves once a turn of lift but follows the load; other orders are gears, "
            "not the encoder",
        source="off-centre code discs: eccentricity over grating radius", prior_probability=0.02),
)
# fmt: on
