// Every English text of the page. {name} is filled in by t(). Other languages: texts.<code>.json, with the same keys.
export const TEXTS = {
  sim: "SIM", real: "REAL",
  sim_long: "simulated machine", real_long: "REAL MACHINE: motion is physical",
  footer: "STOP here is software. The emergency stop is hardware, at the machine; this page can only show its state.",
  server_silent: "The server does not answer (silent for {age}). The values on this page are out of date. The PLC stops the machine by itself when the link is silent.",
  reconnecting: "Connecting to the server …",
  stop_button: "Stop motion (software)", stop_hint: "or key Esc", stop_sent: "sent …", stop_heard: "STOP received", stop_not_heard: "NOT CONFIRMED",
  stop_unheard: "The server did not confirm the STOP. Use the emergency stop at the machine.", language: "Language",
  logged_out: "You are logged out: the server restarted, or the session expired after 12 hours. The values on this page are out of date.", log_in: "Log in again", log_out: "Log out {name}",
  // control
  control_none: "No one has control", control_you: "You have control", control_other: "{owner} has control",
  control_left: "expires in {s} s unless renewed", control_stale: "stale: its holder is disconnected", control_kept: "renewed by this page",
  control_lost: "Control was lost: {why}",
  take_control: "Take control", take_over: "Take over", ask: "Request control", release: "Release", hand_over: "Hand over to {owner}",
  asked: "{owner} requests control", asked_sent: "Request sent to {owner}.", offered: "Control is offered to you",
  your_name: "Your name", name_hint: "visible to all viewers",
  no_control: "take control first",
  other_control: "{owner} has control",
  // chips
  plc: "PLC", camera: "Camera", safety: "E-stop", alarms: "Alarms", alarms_n: "Alarms ({n})", never: "no data yet",
  plc_sub: "{age}, {loss} % lost", camera_text: "{fps} pairs/s", camera_sub: "{age} old", camera_unfit: "not usable for a look",
  plc_silent: "no answer", camera_silent: "no image", last_ago: "last {age} ago", camera_frozen: "FROZEN", camera_late: "late",
  estop_sub: "enable {enable}", enable_needed: "needed", not_known: "not known", no_image: "no image", dry_run: "DRY RUN: valves stay neutral",
  alarm_none: "no alarm", alarm_seen: "{n} acknowledged", alarm_was: "cause gone: {title}",
  // camera
  camera_title: "Camera, left eye", frame_age: "{fps} pairs/s · {age} old", veil_old: "old: {age}", veil_none: "no image yet",
  veil_camera: "no new images: check the camera and its cable", veil_server: "the server does not answer", veil_way: "images arrive late: this computer or its network is overloaded",
  target_choose: "Choose target", target_cancel: "Do not choose", target_use: "Use this target", target_clear: "Back to markers",
  target_click: "Click a place on the rock.", target_measuring: "Measuring …", target_markers: "Target: the object's markers",
  target_found: "{mm} mm away, known to ± {place} mm and ± {deg}° (95 %), patch of {radius} mm", target_in_use: "Target: a chosen place, normal known to ± {deg}° (95 %)",
  marks_find: "Find holes", mark_diameters: "diameters, mm", marks_searching: "Searching …", marks_found: "{n} holes or rings found; click one.",
  target_refused: "Not measured: {why}",
  objects_title: "Taught objects", object_which: "object", object_use: "Use this object", object_remove: "Remove", object_view: "Take a view", object_forget: "Forget views",
  object_about: "To teach: markers next to the object, both in the picture; take a view from three or four sides, then give it a name.",
  object_centre: "Centre of the object, measured from its markers, mm:", object_size: "Size of the object, mm:", object_width: "width", object_height: "height", object_depth: "depth", object_name: "name", object_teach: "Teach",
  object_views: "{n} views, landmarks: {marks}", object_no_views: "No view taken.", object_in_use: "Target: the object {name}. Back to markers ends it.",
  target_reach_reachable: "The tool can reach it.", target_reach_refused: "Cannot be reached from here: {why}", target_reach_unknown: "{why}",
  marker_unused: "not used", legend_tool: "tool", legend_goal: "goal", 
  picture_label: "Camera image. {n} markers detected. {text}", frozen: "FROZEN for {age}",
  // scene
  scene_title: "Machine", scene_sub: "solid: now · blue: plan · green: remaining error, × 10",
  scrub: "along the path", scene_off: "The 3D view is not running: {problem}. Everything else works; the view restarts automatically.", scene_loading: "The 3D view is loading …", scene_title_frame: "Machine in 3D",
  hide_scene: "Hide 3D", show_scene: "Show 3D", scene_hidden: "The 3D view is switched off on this page.",
  // errors
  errors_title: "Tool error at the goal", goal_line: "goal: {z} mm in front of the target{shift}", goal_shift: ", shifted {x}, {y} mm",
  before: "last look ± 2σ", now: "now", predicted: "after move", axis_x: "X", axis_y: "Y", axis_z: "Z, depth", axis_norm: "distance",
  axis_rotation: "rotation", allowed: "allowed ± {mm} mm, {deg}°", not_seen: "not visible",
  bar_label: "{axis}: now {now}, last look {before}, allowed ± {limit}, predicted ± {sigma} (2 sigma)",
  verdict_none: "No look yet.", verdict_failed: "Look failed: {why}", verdict_old: "The last look is {age} old: look again.",
  verdict_inside: "✓ Within tolerance, including 2σ", verdict_near: "Value within tolerance, but not including 2σ",
  verdict_outside: "✗ Out of tolerance",
  // steps
  steps_title: "Steps", next: "Next: {what}", busy: "{kind} by {owner}: {text} ({s} s)", done: "At the goal and accepted.",
  step_look: "Look", step_orient: "Orient", step_calibrate: "Calibrate", step_preview: "Preview", step_execute: "Execute",
  step_look_again: "Look again", step_accept: "Accept",
  step_retract: "Retract", step_return: "Return", step_park: "Park", step_position: "Automatic", step_reset: "Reset fault",
  about_look: "measure the error", about_orient: "face the target: MOVES", about_calibrate: "short path: MOVES",
  about_preview: "plan; nothing moves", about_execute: "drive this plan: MOVES", about_look_again: "measure again",
  about_accept: "record the result", about_retract: "{mm} mm back: MOVES", about_return: "to the start: MOVES", about_park: "fold: MOVES",
  about_position: "all steps: MOVES", about_reset: "at the PLC; nothing moves", about_held: "HOLD: moves while held", about_held_mm: "HOLD: {mm} mm back", hold_mode: "hold-to-run, as on the real machine",
  hold_forced: "REAL: motion only while the button is held", holding: "Moving while held. Release to stop.", hold_again: "The previous motion is still ending: press again.", hold_ended: "Stopped: {why}",
  why_running: "running", busy_short: "{kind} is running", why_no_look: "look first", why_look_old: "look is too old: look again", why_moved: "moved since the last look: look again", why_look_again: "look again first", why_calibrated: "valid; again: MOVES", why_no_plan: "preview first",
  why_expired: "preview has expired", why_not_inside: "not in tolerance", why_accepted: "accepted", why_server: "no answer from server", why_plc_offline: "PLC is silent", why_plc_fault: "PLC fault", why_plc_local: "in local control", why_camera: "no current image",
  hint_offline: "PLC silent: check its program, cable and address", hint_fault: "PLC fault: remove its cause, then press Reset fault", hint_local: "The machine is in local (lever) control", hint_camera: "No current image: check the camera and its cable",
  why_first: "look first", why_calibrate_first: "calibrate first",
  plan: "plan", plan_text: "{hash}, valid for {s} s", path: "path", path_text: "{mm} mm in {s} s, max. {v} mm/s",
  clearance: "clearance", clearance_text: "min. {mm} mm to the wall", clearance_none: "wall position unknown", caution: "caution",
  travel: "joint travel", checks: "checks", checks_text: "joint limits, speed and wall clearance checked by the planner",
  more: "Goal and options", goal_edit: "Goal", stand_off: "in front, mm", offset_x: "shift X, mm", offset_y: "shift Y, mm", set_goal: "Set", retract_mm: "Retract by, mm",
  // jog
  jog_title: "Jog: move one axis slowly", jog_axis: "joint or axis of the tool", jog_about: "HOLD − or +: moves slowly, stops when released", jog_joint: "joint {n}, {joint}",
  jog_x: "Tool x: + moves it up in the picture", jog_y: "Tool y: + moves it left in the picture", jog_z: "Tool z: + moves it back, − towards the target",
  jog_rx: "tool, turn about x: + to the left", jog_ry: "tool, turn about y: + down", jog_rz: "tool, roll about z: + counterclockwise",
  jog_hold: "Jog {axis}, {sign}: hold", jog_plus: "positive", jog_minus: "negative", jog_now: "now {now}°, range {low}° to {high}°",
  jog_running: "moving; release to stop", jog_done: "Jog has ended: {why}",
  // history
  history: "History", alarms_tab: "Alarms", joints: "Joints", story: "Log", n: "#", time: "time", after: "after", inside: "inside",
  accepted_by: "accepted by {who}", yes: "✓ yes", no: "✗ no", trend: "Distance to the goal at each look, mm, log scale; green: tolerance",
  trend_label: "Trend of the distance over {n} looks, now {now} mm", no_history: "No look yet.", 
  // alarms
  no_alarms: "No alarm.", since: "since {time}", over: "cause gone at {time}: read, then acknowledge", still: "still active", cause: "Cause", remedy: "What to do", clears: "Who may clear it",
  acknowledge: "Acknowledge", acknowledged: "acknowledged by {who}", help: "help", ack_note: "Acknowledging never starts a motion.",
  priority_high: "HIGH", priority_medium: "MEDIUM", priority_low: "LOW",
  // drawer
  engineering: "Engineering", close: "Close", tab_link: "Link", tab_vision: "Vision", tab_calibration: "Calibration", tab_gap: "Gap",
  tab_recordings: "Recordings", tab_settings: "Settings", version: "version",
  lateness: "Delay of PLC states behind the fastest, last 10 s", buffer: "PLC buffer", buffer_min: "minimum while moving", loss: "lost, last 10 s",
  send_late: "send delay of commands, p50 / p99 / max", round_trip: "round trip", counts: "sent / received / rejected / overrun", rejects: "last rejects", none: "none",
  sharpness: "sharpness", process: "processing time per pair", skipped: "pairs skipped", restarts: "restarts of the vision process", tool_seen: "tool", target_seen: "target", warnings: "warnings",
  not_calibrated: "Not calibrated.", cal_known: "camera rotation, 1σ", cal_residual: "residual", cal_age: "age", cal_place: "distance from where it was made",
  cal_valid: "valid here", cal_expired: "EXPIRED: {why}", cal_offset: "camera time offset", cal_nominal: "deviation from the nominal mount", cal_weakest: "least certain axis (TCP)",
  cal_limit: "{value} (limit {limit})", cal_ellipse: "Camera rotation: 1σ ellipses, degrees", cal_pairs: "pairs used",
  gap_empty: "No diagnosis yet. Choose the recording of a job that moved all joints: a calibration, an execution, or Automatic. It takes one to three minutes.",
  gap_missing: "Not available: this server offers no diagnosis (/v1/diagnoses).", gap_silent: "no answer from server; asking again", gap_run: "Diagnose", gap_report: "Full report", gap_stop: "Cancel", gap_one: "one at a time", gap_after: "{s} s", gap_cause: "effect", gap_likely: "probability",
  gap_state_running: "Running", gap_state_done: "Done", gap_state_failed: "Failed", gap_state_stopped: "Cancelled", gap_joint: "{name}, joint {joint}",
  gap_none: "NO GAP: the machine agrees with the model, within what the recording can resolve", gap_effects: "EXPLAINED: these effects cause the gap",
  gap_partly: "PARTLY EXPLAINED: the listed effects are confirmed; the cause of the remaining gap is unknown", gap_tool: "at the tool",
  gap_outside: "OUTSIDE: there is a gap that no effect of the catalogue explains; do not act on the effects below",
  gap_undecided: "UNDECIDED: the recording cannot distinguish the candidates; do not act on the effects below",
  gap_next: "Record next: {what} ({minutes} min), because {why}.", gap_intro: "Where model and machine differ, from one recording. Runs in the background; nothing moves.",
  identify_title: "Identify this machine", identify_about: "One test drive measures what the model leaves out: dead bands, gains, sag, encoder zeros, the camera mount. Nothing moves before you have seen the plan.",
  identify_plan: "Identify this machine", identify_minutes: "minutes", identify_free: "I confirm: no wall is within reach (needed where none is measured)", identify_rest: "Plan the remaining parts", identify_drive: "Execute", identify_held: "hold to move; release to pause at rest", identify_clicked: "STOP pauses it; the recording stays usable",
  identify_facts: "{min} min, {looks} looks, TCP at most {v} mm/s, at least {clear} mm from the wall", identify_part: "part", identify_lasts: "duration", identify_shows: "identifies", identify_cannot: "cannot identify",
  identify_in_use: "In use: found {when} on {serial}", identify_kept: "Found {when} on {serial}, not in use", identify_use: "Use these effects", identify_apply: "Apply selection", identify_off: "Use none", identify_file: "machine file", identify_does: "used for", identify_sim_only: "simulation only",
  identify_compare: "Compare: a first move by kinematics alone", identify_compare_about: "The error that a move based on one look and kinematics alone would have had, computed from the same two looks.", identify_move: "move", identify_nominal: "nominal model", identify_with: "with these effects", identify_miss: "model error", identify_left: "remaining",
  recordings_intro: "Each job is recorded as MCAP, which Foxglove opens directly:", download: "download", replay: "replay", layout: "Foxglove layout", rerun: "For Rerun, with a blueprint:",
  disk: "{gb} GB free", recording_on: "recording now", no_recordings: "No recording yet.", settings_intro: "Read-only. To change a setting, edit the settings file and restart the server.",
  replay_title: "Replay of {name}", replay_empty: "The recording {name} could not be opened. Check that its file is still there; `longreach recording check` states what is damaged.", replay_at: "{s} s of {end} s", replay_slider: "time in the run",
  loading: "Reading …", unit: "unit", value: "value", setting: "setting",
  // tour
  tour_next: "Next", tour_end: "Got it", tour_again: "Tour",
  tour_1: "1 of 5. Top: SIM or REAL, who has control, how fresh PLC and camera are. Anyone can press STOP at any time, also with the Esc key.",
  tour_2: "2 of 5. Press Take control. One person commands at a time; everyone can watch, and everyone can stop.",
  tour_3: "3 of 5. Steps: the coloured button is the next step. A disabled button states the reason.",
  tour_4: "4 of 5. Tool error at the goal: a bar inside the green band is within tolerance. An outdated value is crossed out.",
  tour_5: "5 of 5. Execute runs exactly the plan that you previewed, once. On a real machine it moves only while you hold the button.",
  // refusals
  part_failed: "A part of this page ({name}) failed: {why}. Reload the page; STOP still works.",
  refused: "Refused: {why}",
};

let catalogue = { panel: {}, alarms: {}, phrases: {} };
export const useCatalogue = (other) => { catalogue = other; };

// English where the chosen language has no text.
export function t(key, values = {}) {
  const text = catalogue.panel[key] ?? TEXTS[key];
  if (text === undefined) throw new Error(`no text for ${key}`);
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

// The server's own words: a fixed phrase, and the text of an alarm (title, cause, remedy).
export const phrase = (english) => catalogue.phrases[english] ?? english;
export const alarmText = (alarm, part) => catalogue.alarms[alarm.code]?.[part] ?? alarm[part];

export function fillTexts(root) {
  for (const element of root.querySelectorAll("[data-t]")) element.textContent = t(element.dataset.t);
  for (const element of root.querySelectorAll("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label));
}
