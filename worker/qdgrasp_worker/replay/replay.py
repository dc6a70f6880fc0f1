"""Replays one evaluation: carries it out again as it was, and records its course.

Started as `python -m qdgrasp_worker.replay.replay FOLDER` (`qdgrasp_protocol.replay_messages`). No shortcut
is taken: the hand closes to the end where an evaluation would already know that it misses.
"""

import os
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import numpy as np
import typer

from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.engines import engine_names
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.replay_messages import ANSWER, REQUEST, SCENE, ReplayAnswer, ReplayRequest
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_worker.candidate_ranking import TableFilter
from qdgrasp_worker.decoder import DecodedGrasps, Decoder
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluation_protocols import scene_protocol
from qdgrasp_worker.evaluator import contact_columns, make_episode, verdict_in_all
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.replay.episode_recorder import EpisodeRecorder, make_pose


def replay_evaluation(scene: Scene, request: ReplayRequest) -> ReplayAnswer:
    """Carry an evaluation out again, the course in the scene's first engine, the verdict in all."""
    protocol = scene_protocol(scene)
    with closing(make_world(scene, protocol)) as world:
        recorder = EpisodeRecorder(world, scene.gripper)
        episode = make_episode(world, protocol, stops_early=False)
        grasps = requested_grasp(scene, request)
        trial = protocol.trial(grasps[0], request.trial)
        if request.trial == 0 and len(TableFilter(scene)(grasps, np.arange(1))):
            episode.overlaps(trial)
            verdict = EpisodeResult(Outcome.OVERLAP, trial.pose.joints)
        else:
            verdict = episode.run(trial)
    with ExitStack() as opened:
        names = engine_names(scene.engine)[1:]
        others = [opened.enter_context(closing(make_world(scene, protocol, name))) for name in names]
        found = verdict_in_all(verdict, others, protocol, trial, stops_early=False)
    links, points = contact_columns(found.contacts, scene.contact_slots)
    return ReplayAnswer(
        outcome=found.outcome,
        fitness=found.fitness,
        joints=tuple(found.joints),
        contacts=found.finger_links,
        penetration=found.penetration,
        settled=make_pose(found.settled[:3], found.settled[3:]),
        contact_links=tuple(links),
        contact_points=tuple(points),
        snapshots=tuple(recorder.snapshots),
    )


def requested_grasp(scene: Scene, request: ReplayRequest) -> DecodedGrasps:
    """The requested grasp."""
    genome = np.array([request.genome], dtype=np.float32)
    return Decoder(scene, GIVEN, ObjectSurface(scene))(genome)


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def replay_folder(folder: Path) -> None:
    """Replay the evaluation of a folder's request, and write the answer beside it."""
    with lifetime("qdgrasp-replay") as stop:
        stop.tell(lambda: os._exit(stop.exit_code))  # only a temporary folder is left behind
        request = msgspec.json.decode((folder / REQUEST).read_bytes(), type=ReplayRequest)
        answer = replay_evaluation(unpack_scene((folder / SCENE).read_bytes()), request)
        (folder / ANSWER).write_bytes(msgspec.json.encode(answer))


if __name__ == "__main__":
    run_command(app, "qdgrasp-replay")
