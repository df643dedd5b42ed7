"""Effects of the stages time and link: their parameters, bounds and priors, and what distinguishes each."""

from machine.effects.spec import Effect, Parameter, Prior

# fmt: off
EFFECTS: tuple[Effect, ...] = (
    # clock_offset: the camera's stamps are a constant off the PLC's clock.
    Effect(name="clock_offset", stage="time", scope="machine",
        parameters=(
            Parameter(name="offset_s", unit="s", plausible_min=-0.5, plausible_max=0.5, start_value=0.05,
                prior=Prior("normal", 0.1),
                meaning="t_camera = t_true + offset"),
        ),
        looks_like="while moving, the seen pose trails or leads the encoders by speed times offset; nothing at rest",
        distinguished_by="the same as camera_latency unless one of the two is known by a round trip or a flash; "
            "clock_drift grows with time; link delays show between sent and received reference",
        source="Kalibr's and OpenVINS' time offset calibration; clock offset U(0,150) ms of the plant's presets",
        prior_probability=0.1),
    # clock_drift: the camera's clock runs at another rate.
    Effect(name="clock_drift", stage="time", scope="machine",
        parameters=(
            Parameter(name="rate_ppm", unit="ppm", plausible_min=-1000.0, plausible_max=1000.0, start_value=50.0,
                prior=Prior("normal", 50.0),
                meaning="the camera's clock runs fast by this share"),
            Parameter(name="zero_s", unit="s", plausible_min=-60.0, plausible_max=60.0, start_value=0.0,
                prior=Prior("uniform"),
                meaning="when both clocks were right, after the recording's start", role="shape"),
        ),
        looks_like="an offset between camera and encoders that grows evenly with time",
        distinguished_by="clock_offset is constant; needs motion early and late in the recording",
        source="crystal oscillators: 20 to 100 ppm", prior_probability=0.02),
    # transport_delay: the reference reaches the PLC later than nominal.
    Effect(name="transport_delay", stage="link", scope="machine",
        parameters=(
            Parameter(name="delay_s", unit="s", plausible_min=0.0, plausible_max=0.5, start_value=0.02,
                prior=Prior("half_normal", 0.05),
                meaning="beyond the nominal transport delay"),
        ),
        looks_like="the received reference is the sent one, shifted in time, whatever its shape",
        distinguished_by="valve_lag rounds steps off, a delay only shifts them; a constant error of the PLC-to-PC "
            "clock offset looks the same in one direction and needs a round trip",
        source="command latency is the first suspect of sim-to-real users; delays up to 0.7 s on an excavator (Egli "
            "and Hutter 2022)",
        prior_probability=0.3),
    # packet_loss: some datagrams never arrive and the PLC holds the last reference.
    Effect(name="packet_loss", stage="link", scope="machine",
        parameters=(
            Parameter(name="loss_frac", unit="1", plausible_min=0.0, plausible_max=0.5, start_value=0.05,
                prior=Prior("half_normal", 0.05),
                meaning="share of the reference's datagrams that never arrive; the last one is held"),
        ),
        looks_like="single steps of the received reference are missing at random, in all joints together; skipped "
            "sequence numbers",
        distinguished_by="reference_quantisation depends on the value, not on time; transport_delay shifts every "
            "sample",
        source="UDP link without repeats", prior_probability=0.1, has_threshold=True),
    # reference_quantisation: the reference is rounded on its way.
    Effect(name="reference_quantisation", stage="link", scope="joint",
        parameters=(
            Parameter(name="step_rad", unit="rad", plausible_min=0.0, plausible_max=0.01, start_value=0.001,
                prior=Prior("half_normal", 0.001),
                meaning="the received reference is a whole multiple of it"),
        ),
        looks_like="the received reference moves in equal stairs, most visible at slow motion",
        distinguished_by="packet_loss gives stairs of unequal height at random times; a gap that depends on the "
            "value only",
        source="integer set-points of field buses", prior_probability=0.05, has_threshold=True),
    # reference_rate_limit: the PLC follows the reference at no more than a set speed.
    Effect(name="reference_rate_limit", stage="link", scope="joint",
        parameters=(
            Parameter(name="rate_rad_s", unit="rad/s", plausible_min=0.005, plausible_max=3.0, start_value=0.15,
                prior=Prior("log_uniform"),
                meaning="largest speed of the received reference", neutral_value=float("inf")),
        ),
        looks_like="fast parts of the received reference become straight lines; slow parts are untouched",
        distinguished_by="transport_delay also shifts slow parts; controller_saturation limits the valve command, "
            "not the reference",
        source="ramp limits of PLC axis blocks", prior_probability=0.05),
)
# fmt: on
