"""`qdgrasp run`, `resume` and `rerank`: runs that this machine carries out."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import msgspec
import numpy as np
import typer

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.grasp_quality import GraspLimits, object_motion, settled_mask, settled_poses
from qdgrasp_coordinator.metrics.successes import Successes, TrialPlan, all_successes, best_first
from qdgrasp_coordinator.scheduler import run_plan
from qdgrasp_coordinator.search import source_runs
from qdgrasp_coordinator.storage import hand_files
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import NO_FILES, Files, PreparedScene, RunFolder
from qdgrasp_protocol import cli_support
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import EndedEarly, FolderError, InputError, UnknownName
from qdgrasp_protocol.process import Stop, lifetime
from qdgrasp_protocol.rows import TRIAL_COUNTS, TRIALS, Outcome, Rows
from qdgrasp_protocol.spec import MAX_POPULATION, STOP_KEYS, RunSpec, engine_names, read_run_spec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.campaign.campaign_folder import extend_run
from qdgrasp_tools.campaign.ranking import write_ranking
from qdgrasp_tools.cli import options
from qdgrasp_tools.local.progress import ProgressDisplay, progress_display, progress_messages
from qdgrasp_tools.local.supervisor import LocalJobConfig, Supervisor, check_engines, score_genomes
from qdgrasp_tools.report.run_report import genome_reader, run_summary
from qdgrasp_tools.verification.wrong_rows import take_errors_back


def run_job(job: JobFolder, config: LocalJobConfig, shown: ProgressDisplay, stop: Stop) -> None:
    """Carry a job out; an error that ends it early names the command that continues it."""
    try:
        Supervisor(job, config, shown, stop).run()
    except EndedEarly as error:
        raise EndedEarly(f"{error} {resume_hint(job)}") from None


def check_not_stopped(job: JobFolder, stop: Stop) -> None:
    """Exit if there was a signal, and name the command that continues the job."""
    if stop.is_set:
        echo(f"Stopped; {resume_hint(job)}", err=True)
        raise typer.Exit(stop.exit_code)


def resume_hint(job: JobFolder) -> str:
    """Name the command that continues a job."""
    return f"`{job.resume_command}` continues where it stopped."


HAND = "gripper"  # Folder of a run with the guessed file of its hand


@options.spec_flags(
    "gripper", "object", "mass", "units", "mesh", "on", "avoid", "method", "seed", "protocol", "engine",
    "resting_pose", "scene", "evaluations", "grasps",
)  # fmt: skip
def run(
    keys: dict[str, Any],
    spec: Annotated[
        Path | None, typer.Argument(metavar="SPEC.toml", help="A spec; flags replace what it says.")
    ] = None,
    seconds: options.Seconds = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder; default: one in runs, named after what it is.")
    ] = None,
    workers: options.Workers = None,
    listen: options.Listen = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
) -> None:
    """Fill an archive of grasps: a coordinator, a recorder and workers on this machine.

    Of a hand's URDF or MJCF file the rest is guessed, said, and written to the run's folder. A mesh file
    without a mass is taken at 500 kg/m3.

    Example: qdgrasp run --gripper panda --object mug --evaluations 3000

    Example: qdgrasp run --gripper hand.urdf --object part.stl --units mm --mass 0.3
    """
    values = read_run_spec(spec) if spec else {}
    if "cross" in values:
        raise InputError(f"{spec} asks for many runs: `qdgrasp campaign {spec}` carries them out.")
    asked = run_plan.asked_spec(values | keys, str(spec) if spec else "run")
    count, engines = options.worker_count(workers, asked.engine), engine_names(asked.engine)
    config = LocalJobConfig(count, listen, security, insecure, seconds, engines)
    place = out or Path("runs") / run_plan.default_run_name(asked)
    RunFolder.check_free(place)
    weighed = run_plan.with_mass(asked)
    if weighed.mass != asked.mass:
        echo(f"mass       {weighed.mass} kg, at {run_plan.USUAL_DENSITY:g} kg/m3 (--mass)")
    if not options.is_robot_file(asked.gripper):
        start_run(weighed, place, config)
        return
    with TemporaryDirectory(prefix="qdgrasp-") as folder:
        name = Path(HAND, Path(asked.gripper).with_suffix(".toml").name)
        hand_files.write_guess(Path(asked.gripper), folder / name, echo)
        prepared = build_scene_of(msgspec.structs.replace(weighed, gripper=str(folder / name)), config)
        made = (file for file in Path(folder).rglob("*") if file.is_file())
        files = {str(file.relative_to(folder)): file.read_bytes() for file in made}
    guessed = msgspec.structs.replace(weighed, gripper=str((place / name).absolute()))
    start_run(guessed, place, config, more=files, prepared=prepared)


def start_run(
    spec: RunSpec,
    out: Path,
    config: LocalJobConfig,
    job: str | None = None,
    more: Files = NO_FILES,
    prepared: PreparedScene | None = None,
) -> None:
    """Begin a run in a new folder, with `more` files in it, and carry it out."""
    RunFolder.check_free(out)
    _, bundle = prepared or build_scene_of(spec, config)
    with progress_display(out.name, spec.evaluations) as shown, lifetime("qdgrasp run") as stop:
        folder = RunFolder.create(out, spec, bundle, job=job, more=more)
        run_job(folder.job, config, shown, stop)
    print_result(folder, stop, is_timed=config.seconds is not None)


def build_scene_of(spec: RunSpec, config: LocalJobConfig, like: Scene | None = None) -> PreparedScene:
    """Build the scene of a run that this machine carries out.

    Raises InputError if hand or object differ from those of the scene `like`.
    """
    check_engines([spec], config.workers)
    echo(f"building the scene of {options.scene_words(spec)}", err=True)
    with progress_messages() as tell:
        prepared = run_plan.prepare_scene(spec, tell=tell)
    if like is not None:
        _check_same(like, prepared.scene)
    return prepared


def print_result(folder: RunFolder, stop: Stop, *, is_timed: bool = False) -> None:
    """Print the run's figures; exit if there was a signal, or the run is not finished.

    `is_timed`: the run was to end after some seconds, so that this is no failure.
    """
    check_not_stopped(folder.job, stop)
    found = run_summary(folder)
    echo(found.words)
    if not found.complete:
        echo(f"It is not finished; {resume_hint(folder.job)}")
        if not is_timed:
            raise typer.Exit(EndedEarly.exit_code)
    elif found.evaluations < found.budget:
        echo(f"It ended early: {found.finished}.")
    echo_errors(found.errors, str(folder.path))
    write_ranking_of(folder)


def echo_errors(errors: int, path: str) -> None:
    """Say on how many rows the simulator failed, if there are any."""
    if errors:
        echo(
            f"The simulator failed on {counted(errors, 'row')}, and their grasps are missing; "
            f"`qdgrasp verify {path}` tries some of them again, --all all; "
            "`qdgrasp resume --again-errors` lets a run go on from before the first."
        )


def write_ranking_of(folder: RunFolder) -> None:
    """Rank the grasps of a complete run that has scored them again."""
    if source_runs.is_reranking(folder):
        echo(write_ranking(folder))


@options.spec_flags("evaluations", "grasps", sets=STOP_KEYS)
def resume(
    directory: options.RunDir,
    keys: dict[str, Any],
    again_errors: Annotated[
        bool, typer.Option("--again-errors", help="Go back to the first row on which the simulator failed.")
    ] = False,
    seconds: options.Seconds = None,
    workers: options.Workers = None,
    listen: options.Listen = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
) -> None:
    """Continue a run where its journal ends; --evaluations extends a finished one.

    So do --grasps, and other keys that end a run by --set, where it ended with these. --again-errors takes
    back the first row on which the simulator failed, and all behind it: the search had heard of that.

    Example: qdgrasp resume runs/panda-mug-portfolio-s0 --evaluations 20000
    """
    folder = RunFolder.open(directory)
    if folder.job.is_campaign:
        raise FolderError(
            f"{folder.path} is a run of a campaign: `qdgrasp campaign {folder.job.path}` continues it."
        )
    folder.job.check_not_in_use()
    with folder.journal():
        pass  # it is readable, and of this spec and scene
    if keys:
        extend_run(folder, **keys)
    if again_errors:
        take_errors_back(folder)
    found = run_summary(folder)
    if found.complete:
        echo(f"{directory} is finished: {found.words}")
        write_ranking_of(folder)
        return
    count = options.worker_count(workers, folder.spec.engine)
    engines = engine_names(folder.spec.engine)
    config = LocalJobConfig(count, listen, security, insecure, seconds, engines)
    check_engines([folder.spec], config.workers)
    with (
        lifetime("qdgrasp resume") as stop,
        progress_display(directory.name, folder.spec.evaluations) as shown,
    ):
        shown.say(f"continuing after {counted(found.evaluations, 'evaluation')}")
        run_job(folder.job, config, shown, stop)
    print_result(folder, stop, is_timed=seconds is not None)


FINALISTS = 100
STILL = 2e-4  # Way of an object in a closing hand, below which it had been at rest [m]


@options.spec_flags("base", "engine", "approach_distance", "resting_pose", *options.LIMITS, sets=())
def rerank(
    directory: options.RunDir,
    keys: dict[str, Any],
    protocol: Annotated[str, typer.Option(help="Evaluation protocol with trials.")] = "robust",
    top: Annotated[
        int, typer.Option(min=1, max=MAX_POPULATION, help="How many grasps; all where there are fewer.")
    ] = FINALISTS,
    candidates: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MAX_POPULATION,
            help="Choose them from so many, by 4 trials of each and 10 of the better.",
        ),
    ] = None,
    trials: Annotated[
        int, typer.Option(min=1, max=TRIALS, help="Trials of each; 20 harder after 100.")
    ] = TRIALS,
    reseat: Annotated[
        bool,
        typer.Option("--reseat/--no-reseat", help="Close a jaw from where it settled, if it holds there."),
    ] = True,
    workers: options.Workers = None,
    listen: options.Listen = None,
    security: cli_support.SecurityOption = None,
    insecure: cli_support.InsecureOption = False,
    job: options.Job = None,
    out: Annotated[Path | None, typer.Option(help="Folder; default runs/RUN-PROTOCOL.")] = None,
) -> None:
    """Score the best grasps of a run again, in many disturbed trials each, and rank them by eta.

    Taken is the best grasp of each cell, or of each kind that the run told apart, and of these the --top
    best. Under `physical` a jaw closes from where it settled before, if the object rests there and is held.
    The folder is that of a run: `qdgrasp resume` continues it, and workers may join; it can be scored
    again. ranking.csv in it holds every grasp by eta.

    With two engines a trial is passed that holds in both.

    Example: qdgrasp rerank runs/demo --top 50 --candidates 400 --resting-pose any

    Example: qdgrasp rerank runs/demo --engine bullet,mujoco --base physical
    """
    if protocol not in TRIAL_COUNTS:
        raise UnknownName("protocol with trials", protocol, TRIAL_COUNTS)
    source = RunFolder.open(directory)
    limits = options.grasp_limits(keys)
    engine = keys.get("engine") or source.spec.engine
    count = options.worker_count(workers, engine)
    config = LocalJobConfig(count, listen, security, insecure, engines=engine_names(engine))
    asked = {"protocol": protocol, "trials": trials} | keys
    out = out or scored_path(source, protocol)
    score_again(source, out, config, asked, limits, top, candidates, reseat=reseat, job=job)


def scored_path(source: RunFolder, protocol: str = "robust") -> Path:
    """The usual folder of the run that scores grasps of another again."""
    return Path("runs") / f"{source.path.absolute().name}-{protocol}"


def scored_run(source: RunFolder, limits: GraspLimits, top: int, candidates: int, **asked: Any) -> RunFolder:
    """Score grasps of a run again by own workers, as `score_again`; return the new run."""
    folder, asked = RunFolder(scored_path(source)), {"protocol": "robust", "trials": TRIALS} | asked
    if source_runs.is_reranking(folder):
        raise FolderError(
            f"{folder.path} has scores already: export it instead, or remove it to score again."
        )
    config = LocalJobConfig(options.worker_count(None, source.spec.engine))
    score_again(source, folder.path, config, asked, limits, top, candidates)
    return folder


def score_again(
    source: RunFolder,
    out: Path,
    config: LocalJobConfig,
    asked: dict[str, Any],
    limits: GraspLimits,
    top: int,
    candidates: int | None,
    *,
    reseat: bool = True,
    job: str | None = None,
) -> None:
    """Score the best grasps of a run again in a new one; `asked` are keys of its spec.

    Of more `candidates` than `top`, spread evenly from little motion to much, those are scored that are
    the best in few trials.
    """
    RunFolder.check_free(out)
    found = _grasps_of(source, limits)
    if ways := {key: asked[key] for key in ("approach_distance", "resting_pose") if key in asked}:
        found = source_runs.reachable_grasps(source, found, **ways)
    kinds = source_runs.kinds_of_run(source.spec, found, genome_reader(source))
    chosen = source_runs.best_of_kinds(found, kinds)
    if top < (count := min(candidates or top, len(chosen))):  # trials choose: from all motions alike
        chosen = chosen[np.linspace(0, len(chosen) - 1, count).round().astype(np.intp)]
    chosen = chosen[: max(top, count)]
    spec = source_runs.rerank_spec(source, chosen, **asked)
    prepared = build_scene_of(spec, config, source.scene())
    is_seated = np.isin(chosen["index"], source.spec.reseated or ())
    if reseat and not is_seated.any() and prepared.scene.gripper.jaw and spec.base == "physical":
        seats = chosen.copy()
        seats["base_to_object"] = settled_poses(chosen)
        once = source_runs.rerank_spec(source, seats, **asked | {"trials": 1})
        tried = _evaluated(once, prepared, config, "closing from where hands settled")
        is_still = object_motion(tried.rows)[:, 0] < STILL  # others slip on with each closing
        is_seated = settled_mask(chosen) & is_still & (tried.rows["outcome"] == Outcome.HELD)
        chosen[is_seated] = seats[is_seated]
    for few, most in ((4, 2 * top), (10, top)):
        if len(chosen) > most:
            spec = source_runs.rerank_spec(source, chosen, **asked | {"trials": few})
            tried = _evaluated(spec, prepared, config, f"trying each grasp {few} times")
            best = best_first(tried.rows, tried.scores)[:most]
            chosen, is_seated = chosen[best], is_seated[best]
    places = tuple(np.flatnonzero(is_seated).tolist()) or None
    spec = msgspec.structs.replace(source_runs.rerank_spec(source, chosen, **asked), reseated=places)
    echo(f"scoring {counted(len(chosen), 'grasp')} of {source.path} again", err=True)
    start_run(spec, out, config, job, source_runs.source_file(source, chosen), prepared)


def _evaluated(spec: RunSpec, prepared: PreparedScene, config: LocalJobConfig, words: str) -> Successes:
    """Evaluate the poses of a spec with own workers; return all of them in their order."""
    genomes = np.array(spec.poses, np.float32)
    with progress_display("rerank", len(genomes)) as shown, lifetime("qdgrasp rerank") as stop:
        shown.say(words)
        rows = score_genomes(spec, prepared, genomes, config, shown, stop)
    if stop.is_set:
        raise typer.Exit(stop.exit_code)
    return all_successes(rows, TrialPlan.of(spec), least=Outcome.ERROR)


def _grasps_of(source: RunFolder, limits: GraspLimits) -> Rows:
    """The grasps of a run within limits."""
    found = source_runs.read_run_grasps(source)
    if not len(found):
        raise InputError(f"{source.path} has found no grasp (fitness 1 or more) that could be scored again.")
    every, found = found, found[limits.admitted(found, source.scene())]
    if not len(found):
        reason = limits.reason(every, source.scene())
        raise InputError(f"{source.path} has no grasp within these limits: {reason}.")
    return found


def _check_same(old: Scene, new: Scene) -> None:
    """Check that two scenes have the same hand and object, so that poses keep their meaning."""

    def meaning(scene: Scene) -> tuple[object, ...]:
        hand, body = scene.gripper, scene.object
        joints = [(each.name, each.opened, each.closed, each.driven) for each in hand.joints]
        ways = hand.base_link, hand.finger_links, hand.synergies, hand.free_joints, joints
        return ways, body.com_in_mesh, body.mesh_vertices, body.mesh_faces

    if meaning(old) != meaning(new):
        raise InputError(
            f"'{new.gripper.name}' or '{new.object.name}' is not what it was when the run was made, so that "
            "its poses mean something else; restore their files."
        )
