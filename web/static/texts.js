// Every English text of the page. {name} is filled in by t().
export const TEXTS = {
  sim: "SIM", real: "REAL",
  sim_long: "simulated machine", real_long: "REAL MACHINE: steel moves",
  footer: "STOP here is software. The emergency stop is hardware, at the machine; this page can only show its state.",
  server_silent: "The server does not answer (silent for {age}). Nothing on this page is current. The PLC stops the machine by itself when its link is silent.",
  reconnecting: "Connecting to the server …",
  logged_out: "You are logged out: the server was started again, or 12 hours are over. Nothing on this page is current.", log_in: "Log in again", log_out: "Log out {name}",
  // control
  control_none: "Nobody has control", control_you: "You have control", control_other: "{owner} has control",
  control_left: "{s} s left unless kept alive", control_stale: "stale: its holder is gone", control_kept: "kept alive by this page",
  control_lost: "Control was lost: {why}",
  take_control: "Take control", take_over: "Take over", ask: "Ask for control", release: "Release", hand_over: "Hand over to {owner}",
  asked: "{owner} asks for control", asked_sent: "Asked. {owner} sees it.", offered: "Control is offered to you",
  take_reason: "taken over at the panel", your_name: "Your name", name_hint: "shown to everybody who looks",
  no_control: "take control first",
  other_control: "{owner} has control",
  // chips
  plc: "PLC", camera: "Camera", safety: "E-stop", alarms: "Alarms", alarms_n: "Alarms ({n})", never: "never heard", 
  plc_sub: "{age}, {loss} % lost", camera_text: "{fps} pairs/s", camera_sub: "{age} old", camera_unfit: "not fit for a look",
  plc_silent: "no answer", camera_silent: "no picture", last_ago: "last {age} ago", camera_frozen: "FROZEN", camera_late: "late",
  estop_sub: "enable {enable}", enable_needed: "needed", no_image: "no picture", dry_run: "DRY RUN: valves stay neutral",
  alarm_none: "no alarm", alarm_seen: "{n} acknowledged", alarm_was: "ended: {title}",
  // camera
  camera_title: "Camera, left eye", frame_age: "{fps} pairs/s · {age} old", veil_old: "old: {age}", veil_none: "no picture yet",
  veil_camera: "no new picture comes: check the camera and its cable", veil_server: "the server does not answer", veil_way: "pictures come late to this page: this computer or its network is busy",
  target_choose: "Choose target", target_cancel: "Do not choose", target_use: "Use this target", target_clear: "Back to markers",
  target_click: "Click a place on the rock.", target_measuring: "Measuring …", target_markers: "Target: the object's markers",
  target_found: "{mm} mm away, known to ± {place} mm and ± {deg}° (95 %), patch of {radius} mm", target_in_use: "Target: a chosen place, normal known to ± {deg}° (95 %)",
  target_refused: "Not measured: {why}",
  legend_tool: "tool", legend_goal: "goal", 
  picture_label: "Camera picture. {n} markers seen. {text}", frozen: "FROZEN for {age}",
  // scene
  scene_title: "Machine", scene_sub: "solid: now · blue: plan · green: error left, × 10",
  scrub: "along the path", scene_off: "The 3D view is not running: {problem}. Everything else works; it is started again by itself.", scene_loading: "The 3D view is loading …", scene_title_frame: "Machine in 3D",
  hide_scene: "Hide 3D", show_scene: "Show 3D", scene_hidden: "The 3D view is switched off on this page.",
  // errors
  errors_title: "Tool against goal", goal_line: "goal: {z} mm in front of the target{shift}", goal_shift: ", shifted {x}, {y} mm",
  before: "last look ± 2σ", now: "now", predicted: "after move", axis_x: "X", axis_y: "Y", axis_z: "Z, depth", axis_norm: "distance",
  axis_rotation: "rotation", allowed: "allowed ± {mm} mm, {deg}°", not_seen: "not seen",
  bar_label: "{axis}: now {now}, last look {before}, allowed ± {limit}, predicted ± {sigma} (2 sigma)",
  verdict_none: "No look yet.", verdict_failed: "Look failed: {why}", verdict_old: "The last look is {age} old: look again.",
  verdict_inside: "✓ Inside tolerance (two sigma to spare)", verdict_near: "Inside by its value, but not with two sigma to spare",
  verdict_outside: "✗ Outside tolerance",
  // steps
  steps_title: "Steps", next: "Next: {what}", busy: "{kind} by {owner}: {text} ({s} s)", done: "On target and accepted.",
  step_look: "Look", step_orient: "Orient", step_calibrate: "Calibrate", step_preview: "Preview", step_execute: "Execute",
  step_look_again: "Look again", step_accept: "Accept",
  step_retract: "Retract", step_return: "Return", step_park: "Park", step_position: "Automatic", step_reset: "Reset fault",
  about_look: "measure the error", about_orient: "face the target: MOVES", about_calibrate: "short path: MOVES",
  about_preview: "plan; nothing moves", about_execute: "drive this plan: MOVES", about_look_again: "measure anew",
  about_accept: "note the result", about_retract: "{mm} mm back: MOVES", about_return: "to the start: MOVES", about_park: "fold: MOVES",
  about_position: "all steps: MOVES", about_reset: "at the PLC; nothing moves", about_held: "HOLD: moves while held", about_held_mm: "HOLD: {mm} mm back", hold_mode: "hold-to-run, as on the real machine",
  hold_forced: "REAL: motion only while the button is held", holding: "Moving while held. Let go to stop.", hold_again: "The last motion is still ending: press again.", hold_ended: "Stopped: {why}",
  why_running: "running", busy_short: "{kind} is running", why_no_look: "look first", why_look_old: "look is old: look again", why_moved: "moved since the look: look again", why_look_again: "look again first", why_calibrated: "holds; again: MOVES", why_no_plan: "preview first",
  why_expired: "preview has expired", why_not_inside: "not in tolerance", why_accepted: "accepted", why_server: "no answer from server", why_plc_offline: "PLC is silent", why_plc_fault: "PLC fault", why_plc_local: "on its local lever", why_camera: "no fresh picture",
  hint_offline: "PLC silent: check its program, cable and address", hint_fault: "PLC fault: clear its cause, then press Reset fault", hint_local: "The machine is on its local lever", hint_camera: "No fresh picture: check the camera and its cable",
  why_first: "look first", why_calibrate_first: "calibrate first",
  plan: "plan", plan_text: "{hash}, good for {s} s more", path: "path", path_text: "{mm} mm in {s} s, at most {v} mm/s",
  clearance: "to the wall", clearance_text: "{mm} mm at the nearest", clearance_none: "wall not known", caution: "caution",
  travel: "joint travel", checks: "checks", checks_text: "joint limits, speed and wall: ok, by the planner",
  more: "Goal and options", goal_edit: "Goal", stand_off: "in front, mm", offset_x: "shift X, mm", offset_y: "shift Y, mm", set_goal: "Set", retract_mm: "Retract by, mm",
  // history
  history: "History", alarms_tab: "Alarms", joints: "Joints", story: "Story", n: "#", time: "time", after: "after", inside: "inside",
  accepted_by: "accepted by {who}", yes: "✓ yes", no: "✗ no", trend: "Distance to the goal over the looks, mm, logarithmic; green: tolerance",
  trend_label: "Trend of the distance over {n} looks, now {now} mm", no_history: "No look yet.", 
  // alarms
  no_alarms: "No alarm.", since: "since {time}", over: "ended at {time}: read it, then acknowledge it", still: "still so", cause: "Cause", remedy: "What to do", clears: "Who may clear it",
  acknowledge: "Acknowledge", acknowledged: "acknowledged by {who}", help: "help", ack_note: "Acknowledging never starts a motion.",
  priority_high: "HIGH", priority_medium: "MEDIUM", priority_low: "LOW",
  // drawer
  engineering: "Engineering", close: "Close", tab_link: "Link", tab_vision: "Vision", tab_calibration: "Calibration", tab_gap: "Gap",
  tab_recordings: "Recordings", tab_settings: "Settings", version: "version",
  lateness: "How late states come behind the earliest, last 10 s", buffer: "buffer in the PLC", buffer_min: "smallest while moving", loss: "lost, last 10 s",
  send_late: "commands sent late, p50 / p99 / max", round_trip: "round trip", counts: "sent / received / rejected / not fetched in time", rejects: "last rejects", none: "none",
  sharpness: "sharpness", process: "work a pair", skipped: "pairs passed over", restarts: "restarts of vision", tool_seen: "tool", target_seen: "target", warnings: "warnings",
  not_calibrated: "Not calibrated.", cal_known: "camera rotation known to (1 sigma)", cal_residual: "residual", cal_age: "age", cal_place: "from where it was made",
  cal_valid: "holds here", cal_expired: "EXPIRED: {why}", cal_offset: "add to camera time", cal_nominal: "off the nominal mount", cal_weakest: "least known about the axis (TCP)",
  cal_ellipse: "One-sigma ellipses of the rotation, degrees", cal_pairs: "pairs used",
  gap_empty: "No diagnosis yet. Choose the recording of a job that moved all joints: a calibration, an execution, or Automatic. It takes one to three minutes.",
  gap_missing: "Not available: this server has no diagnoses (/v1/diagnoses).", gap_silent: "no answer from server; asking again", gap_run: "Diagnose", gap_report: "The whole report", gap_stop: "End it", gap_one: "one at a time", gap_after: "{s} s", gap_cause: "effect", gap_likely: "probability",
  gap_state_running: "Running", gap_state_done: "Done", gap_state_failed: "Failed", gap_state_stopped: "Ended by hand", gap_joint: "{name}, joint {joint}",
  gap_none: "NO GAP: the machine does what the model says, within what the recording can show", gap_effects: "EXPLAINED: these effects make the gap",
  gap_partly: "PARTLY EXPLAINED: the confirmed effects are right; the rest of the gap has no cause yet", gap_tool: "at the tool",
  gap_outside: "OUTSIDE: a gap is there that nothing in the catalogue explains; do not act on the names below",
  gap_undecided: "UNDECIDED: the recording does not tell the candidates apart; do not act on the names below",
  gap_foreign: "something outside the catalogue", gap_unseen: "one more, too small to be seen here", gap_shrink_doubted: "The names below take {pct} % of the gap away, but are not believed: wrong ones can, too.", gap_shrink: "The most likely ones together take {pct} % of the gap away, on data they were not fitted to.",
  gap_next: "Record next: {what} ({minutes} min), because {why}.", gap_intro: "Where the model and the machine differ, from one recording; runs beside, nothing moves.",
  identify_title: "Identify this machine", identify_about: "One drive shows what the model leaves out: dead bands, gains, sag, zeros, the camera's mount. Nothing moves before you have seen what it will do.",
  identify_plan: "Identify this machine", identify_minutes: "minutes", identify_free: "there is no wall within reach", identify_rest: "Plan the rest", identify_drive: "Drive it", identify_held: "hold; let go to pause at rest", identify_clicked: "STOP pauses it; what was recorded stays usable",
  identify_facts: "{min} min, {looks} looks, TCP at most {v} mm/s, at least {clear} mm from the wall", identify_part: "part", identify_lasts: "lasts", identify_shows: "shows", identify_cannot: "cannot show",
  identify_in_use: "In use: found {when} on {serial}", identify_kept: "Found {when} on {serial}, not in use", identify_use: "Use these effects", identify_apply: "Apply the switches", identify_off: "Use none", identify_file: "machine file", identify_does: "what it changes", identify_sim_only: "nothing; for the simulation only",
  identify_compare: "Compare: a first move by kinematics alone", identify_compare_about: "By how much a move by one look and kinematics alone would have missed, from the same two looks.", identify_move: "move", identify_nominal: "by the machine file", identify_with: "with these effects", identify_miss: "the model misses by", identify_left: "left",
  recordings_intro: "Each job is recorded as MCAP; Foxglove opens it as it is:", download: "download", replay: "replay", layout: "Foxglove layout", rerun: "For Rerun, with a blueprint:",
  disk: "{gb} GB free", recording_on: "recording now", no_recordings: "No recording yet.", settings_intro: "Read-only. Change them in the settings file and start the server again.",
  replay_title: "Replay of {name}", replay_empty: "{name} could not be opened.", replay_at: "{s} s of {end} s", replay_slider: "time in the run",
  loading: "Reading …", unit: "unit", value: "value", setting: "setting",
  // tour
  tour_next: "Next", tour_end: "Got it", tour_again: "Tour",
  tour_1: "1 of 5. Top: SIM or REAL, who has control, how fresh PLC and camera are. STOP is always there, for anybody, also by the key Esc.",
  tour_2: "2 of 5. Press Take control. One person commands at a time; everybody may look, and everybody may stop.",
  tour_3: "3 of 5. Steps: the coloured button is what comes next. A button that cannot be pressed says why.",
  tour_4: "4 of 5. Tool against goal: a bar inside the green band is inside the tolerance. A value that is too old is crossed out.",
  tour_5: "5 of 5. Execute drives exactly the plan that you previewed, once. On a real machine it moves only while you hold the button.",
  // refusals
  part_failed: "A part of this page ({name}) failed: {why}. Load the page anew; STOP works.",
  refused: "Refused: {why}",
};

export function t(key, values = {}) {
  const text = TEXTS[key];
  if (text === undefined) throw new Error(`no text for ${key}`);
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

export function fillTexts(root) {
  for (const element of root.querySelectorAll("[data-t]")) element.textContent = t(element.dataset.t);
  for (const element of root.querySelectorAll("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label));
}
