"""Effects of stage camera: their parameters, bounds and priors, and what distinguishes each."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

# fmt: off
EFFECTS: tuple[Effect, ...] = (
    # focal_length_error: the lens is longer or shorter than calibrated.
    Effect(name="focal_length_error", stage="camera", scope="machine",
        parameters=(
            Parameter(name="scale_frac", unit="1", plausible_min=-0.1, plausible_max=0.1, start_value=0.01,
                prior=Prior("normal", 0.01),
                meaning="true focal length over the nominal one, less 1"),
        ),
        looks_like="everything appears larger or smaller by one factor",
        distinguished_by="marker_size_error scales distances only: the same at one distance, apart at two with known "
            "motion; odometry_scale leaves markers alone",
        source="0.15 % left after a good calibration"),
    # principal_point_error: the optical centre is not where calibrated.
    Effect(name="principal_point_error", stage="camera", scope="machine",
        parameters=(
            Parameter(name="shift_px", unit="px", plausible_min=0.0, plausible_max=60.0, start_value=3.0,
                prior=Prior("half_normal", 3.0),
                meaning="of the principal point along the direction (u right, v down)"),
        ),
        direction=Direction("direction", (1.0, 0.0), "image"),
        looks_like="the whole image is shifted, the same at every distance",
        distinguished_by="hand_eye_rotation is nearly the same for narrow views, but bends perspective; "
            "hand_eye_translation falls with distance",
        source="1 px left after a good calibration"),
    # lens_distortion: straight lines bend outward or inward beyond the nominal lens.
    Effect(name="lens_distortion", stage="camera", scope="machine",
        parameters=(
            Parameter(name="k1", unit="1", plausible_min=-0.4, plausible_max=0.4, start_value=0.02,
                prior=Prior("normal", 0.02),
                meaning="radial coefficient beyond the nominal lens"),
        ),
        looks_like="errors along the radius, growing with its third power, none in the middle",
        distinguished_by="focal_length_error grows in proportion to the radius",
        source="Brown 1966; 0.002 left after a good calibration"),
    # marker_size_error: the print is larger or smaller than stated.
    Effect(name="marker_size_error", stage="camera", scope="machine",
        parameters=(
            Parameter(name="scale_frac", unit="1", plausible_min=-0.2, plausible_max=0.2, start_value=0.01,
                prior=Prior("normal", 0.01),
                meaning="true printed side over the nominal one, less 1"),
        ),
        looks_like="marker distances are off by one factor, though the bearing is right",
        distinguished_by="focal_length_error also scales bearings; stereo distinguishes them by its baseline",
        source="printer scaling: 0.1 mm of 150"),
    # hand_eye_rotation: the camera is turned on its mount.
    Effect(name="hand_eye_rotation", stage="camera", scope="machine",
        parameters=(
            Parameter(name="angle_rad", unit="rad", plausible_min=0.0, plausible_max=0.5, start_value=0.02,
                prior=Prior("half_normal", 0.04),
                meaning="of the camera on its mount, about the axis"),
        ),
        direction=Direction("axis", (0.0, 1.0, 0.0), "cam_left"),
        looks_like="what is seen is turned about the camera; error in proportion to distance",
        distinguished_by="encoder_bias of the last joint is the same until that joint turns; principal_point_error "
            "for narrow views",
        source="mount tilt 3 to 5 deg in the field", prior_probability=0.5),
    # hand_eye_translation: the camera is displaced from its nominal place.
    Effect(name="hand_eye_translation", stage="camera", scope="machine",
        parameters=(
            Parameter(name="distance_m", unit="m", plausible_min=0.0, plausible_max=0.5, start_value=0.01,
                prior=Prior("half_normal", 0.015),
                meaning="of the camera from its nominal place, along the direction"),
        ),
        direction=Direction("direction", (1.0, 0.0, 0.0), "tcp"),
        looks_like="a constant offset in the camera's frame, whatever the distance; seen only when the wrist turns",
        distinguished_by="hand_eye_rotation grows with distance; link_length_error of the last link is the same "
            "direction until the wrist turns",
        source="mounts measured by ruler: 10 mm", prior_probability=0.5),
    # tool_marker_rotation: the tool's marker is turned on the tool.
    Effect(name="tool_marker_rotation", stage="camera", scope="machine",
        parameters=(
            Parameter(name="angle_rad", unit="rad", plausible_min=0.0, plausible_max=0.3, start_value=0.01,
                prior=Prior("half_normal", 0.03),
                meaning="of the marker against the machine file's place on the tool, about the axis"),
        ),
        direction=Direction("axis", (1.0, 0.0, 0.0), "tool"),
        looks_like="what the tool's marker shows of the tool's direction is wrong by this, wherever the arm is",
        distinguished_by="hand_eye_rotation turns what is seen of the object, too",
        source="a marker glued on by hand: 1 deg, millimetres", prior_probability=0.5),
    # tool_marker_translation: the tool's marker is moved on the tool.
    Effect(name="tool_marker_translation", stage="camera", scope="machine",
        parameters=(
            Parameter(name="distance_m", unit="m", plausible_min=0.0, plausible_max=0.05, start_value=0.003,
                prior=Prior("half_normal", 0.005),
                meaning="of the marker against the machine file's place on the tool, along the axis"),
        ),
        direction=Direction("axis", (1.0, 0.0, 0.0), "tool"),
        looks_like="what the tool's marker shows of the tool's place is wrong by this, wherever the arm is",
        distinguished_by="hand_eye_translation moves what is seen of the object, too, once the wrist turns",
        source="a marker glued on by hand: 1 deg, millimetres", prior_probability=0.5),
    # stereo_misalignment: the right eye is turned against the left.
    Effect(name="stereo_misalignment", stage="camera", scope="machine",
        parameters=(
            Parameter(name="angle_rad", unit="rad", plausible_min=0.0, plausible_max=0.1, start_value=0.003,
                prior=Prior("half_normal", 0.003),
                meaning="of the right eye against the left, about the axis"),
        ),
        direction=Direction("axis", (0.0, 1.0, 0.0), "cam_right"),
        looks_like="rows disagree (about x), depth is off with its square (about y), or rows tilt (about z)",
        distinguished_by="focal_length_error scales depth evenly in both eyes; needs both eyes",
        source="rig drift after shocks; 0.1 px disparity bias"),
    # camera_latency: images are stamped later than exposed.
    Effect(name="camera_latency", stage="camera", scope="machine",
        parameters=(
            Parameter(name="latency_s", unit="s", plausible_min=-0.2, plausible_max=0.5, start_value=0.04,
                prior=Prior("normal", 0.05),
                meaning="stamp minus exposure, beyond what is known"),
        ),
        looks_like="while moving, the seen pose trails the encoders; nothing at rest",
        distinguished_by="the same as clock_offset unless the clocks are tied by a round trip",
        source="40 to 80 ms of USB stereo cameras", prior_probability=0.3),
    # rolling_shutter: rows are exposed one after another.
    Effect(name="rolling_shutter", stage="camera", scope="machine",
        parameters=(
            Parameter(name="readout_s", unit="s", plausible_min=-0.05, plausible_max=0.05, start_value=0.01,
                prior=Prior("half_normal", 0.011),
                meaning="from the first row's exposure to the last's"),
            Parameter(name="stamp_row", unit="1", plausible_min=-1.0, plausible_max=1.0, start_value=0.0,
                prior=Prior("uniform"),
                meaning="what the stamp states: 0 the middle row's exposure, 1 the first row's, -1 the last row's",
                role="shape", is_integer=True),
        ),
        looks_like="while moving, the upper half of the image trails the lower or leads it: markers shear",
        distinguished_by="camera_latency shifts all rows alike", source="11 ms readout of CMOS stereo cameras",
        prior_probability=0.05),
    # odometry_scale: visual odometry measures paths too long or too short.
    Effect(name="odometry_scale", stage="camera", scope="machine",
        parameters=(
            Parameter(name="scale_frac", unit="1", plausible_min=-0.3, plausible_max=0.3, start_value=0.02,
                prior=Prior("normal", 0.02),
                meaning="odometry's translation times (1 + scale_frac)"),
        ),
        looks_like="odometry's translations are off by one factor, rotations are right",
        distinguished_by="focal_length_error also changes marker poses and rotations",
        source="0.3 % with a stereo baseline; free with one eye"),
)
# fmt: on
