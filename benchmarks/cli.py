"""`python -m benchmarks ...`, `longreach bench ...`: one subcommand per claim, each imported when it is called."""

import typer

from longreach.lazy_commands import Lazy, LazyGroup

BENCHES = (
    Lazy(
        "reproduce",
        "benchmarks.reproduce.command:reproduce",
        "Tables 2, 3, 4 and Figures 5 to 9: fast over n machines, rendered over a few. Resumes where it was stopped.",
    ),
    Lazy(
        "schedules",
        "benchmarks.link.schedules:schedules",
        "Run seeded fault schedules through the link and watch every PLC cycle.",
    ),
    Lazy(
        "fuzz", "benchmarks.link.fuzz.command:fuzz", "Fuzz both ends of the PLC link; exit code 1 if a rule was broken."
    ),
    Lazy(
        "vision",
        "benchmarks.vision.rate.command:vision",
        "Pairs per second, latency, CPU time by stage; beside them OpenCV's plain detector and toy-vo.",
    ),
    Lazy(
        "odometry",
        "benchmarks.vision.odometry.command:odometry",
        "Stereo odometry on rendered paths of preset realistic, without markers, calibration exact.",
    ),
    Lazy(
        "markers",
        "benchmarks.vision.markers.command:markers",
        "Marker poses over the two-view Cramer-Rao bound, planar flips and covariances, beside OpenCV's.",
    ),
    Lazy(
        "targets",
        "benchmarks.targets.command:targets",
        "Targets without markers: patch errors against stated ellipses, faults found, and point-and-go jobs.",
    ),
    Lazy(
        "hand-eye",
        "benchmarks.hand_eye.command:hand_eye",
        "A X = Y B on real and simulated arms, trajectories beside evo, and kinhec's tracks beside its own solvers.",
    ),
    Lazy(
        "machines",
        "benchmarks.positioning.machines.command:machines",
        "The default method on many machines in the fast world: success by moves, refusals, honest ellipses, times.",
    ),
    Lazy(
        "unchecked",
        "benchmarks.positioning.unchecked:unchecked",
        "Focal lengths and prints that are off alike everywhere: reported, or inside the stated ellipse?",
    ),
    Lazy(
        "ablation",
        "benchmarks.positioning.machines.command:ablation",
        "Each improvement switched off alone, on the same machines: change of the one-move success.",
    ),
    Lazy(
        "camera-faults",
        "benchmarks.vision.camera_faults.command:camera_faults",
        "Inject every camera fault: pairs until it is found, looks that used it, pairs until recovery, false alarms.",
    ),
    Lazy(
        "vision-soak",
        "benchmarks.vision.soak:vision_soak",
        "Markers, odometry and preview on pairs looped from memory: growth of memory per hour and per pair.",
    ),
    Lazy(
        "servo",
        "benchmarks.positioning.servo:servo",
        "Closed-loop control over real UDP and rendered images: does it reach the tolerance, truly.",
    ),
    Lazy(
        "crashes",
        "benchmarks.kills.crashes:crashes",
        "SIGKILL the server at random points of a run; look at what the next life finds.",
    ),
    Lazy(
        "hold",
        "benchmarks.server.hold.command:hold",
        "Hold-to-run in a real browser: time from letting go to the ramp in the PLC's states.",
    ),
    Lazy(
        "load",
        "benchmarks.server.load.command:load",
        "REST answers, PLC underruns and vision's rate: 50 readers and 200 questions a second, a move on.",
    ),
    Lazy(
        "jobs-soak",
        "benchmarks.server.jobs_soak.command:jobs_soak",
        "Memory, handles, tasks and database over many jobs with faults; that the server always finds back.",
    ),
    Lazy(
        "gap",
        "benchmarks.diagnosis.gap.command:gap",
        "Blind cases of the gap diagnosis: names, refusals, probabilities, limits and shrink against sealed truths.",
    ),
    Lazy(
        "first-day",
        "benchmarks.diagnosis.first_day.command:first_day",
        "Sealed machines diagnosed without a baseline: coverage, false effects, sizes, verdicts, probabilities.",
    ),
    Lazy(
        "experiments",
        "benchmarks.diagnosis.experiments.command:experiments",
        "Ambiguous recording, proposed experiment, executed, both diagnosed together: is the true effect sure then?",
    ),
    Lazy(
        "compensation",
        "benchmarks.positioning.compensation.command:compensation",
        "Diagnosed effects compensated against not, paired on drawn machines in the fast world.",
    ),
    Lazy(
        "links",
        "benchmarks.diagnosis.links.command:links",
        "Six joints behind links that jitter, drift, lose and delay, logged every 1 to 10 ms: is only the fault named?",
    ),
    Lazy(
        "diagnosis",
        "benchmarks.diagnosis.cost.command:diagnosis",
        "Time and memory of a diagnosis of eight minutes, six joints and one; a fleet's answers, however made.",
    ),
    Lazy(
        "position",
        "benchmarks.small:position",
        "Position n seeds end to end and compare image-based with true errors.",
    ),
    Lazy(
        "kinematics",
        "benchmarks.small:kinematics",
        "Inverse recovers random joint vectors; microseconds per call.",
    ),
    Lazy("plant", "benchmarks.small:plant", "Real-time factor of the fine plant on one core."),
    Lazy("render", "benchmarks.small:render", "Stereo pairs rendered per second."),
    Lazy(
        "vision-real",
        "benchmarks.small:vision_real",
        "Detector and odometry on real photographs and the KITTI clip.",
    ),
    Lazy(
        "link",
        "benchmarks.small:link",
        "Underruns, lateness and buffer depth of the PLC link in real time beside the vision load.",
    ),
    Lazy(
        "kills",
        "benchmarks.small:kills",
        "SIGKILL in the middle of real jobs: ramp, rest, travel, and that nothing moves again by itself.",
    ),
)


class Benches(LazyGroup):
    """Of `longreach bench`."""

    lazy_commands = BENCHES


app = typer.Typer(cls=Benches, no_args_is_help=True, add_completion=False)


@app.callback()
def measure() -> None:
    """Measure; every figure in the README comes from here."""
