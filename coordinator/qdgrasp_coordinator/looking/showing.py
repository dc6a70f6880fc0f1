"""Showing: one row of a journal as a picture or a film, from its replay to the file."""

from dataclasses import replace

from qdgrasp_coordinator.folders.outputs import OutFile
from qdgrasp_coordinator.looking import agreement
from qdgrasp_coordinator.looking.caption import Caption
from qdgrasp_coordinator.looking.picture import Layout, pictures, write
from qdgrasp_coordinator.looking.replaying import Replay, Wish, platform, replayed
from qdgrasp_coordinator.looking.specimen import Specimen
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.outcome import Outcome


def show(shown: Specimen, wish: Wish, out: OutFile, stop: Stop) -> list[str]:
    """Replay a row and write what is seen.

    Parameters
    ----------
    wish
        Its size is that of the whole picture, caption and all.

    Returns
    -------
    unlike
        What the replay found in place of what is recorded, column by column; nothing where they agree, and of
        a dead end, which was not simulated.

    Raises
    ------
    InputError
        The part that is asked for did not happen, or the file cannot be written.
    NotReplayed
        It could not be replayed.
    """
    layout = Layout(wish.size)
    with replayed(shown, replace(wish, size=layout.scene), stop) as replay:
        if replay is None:
            return []
        unlike, shots = _unlike(shown, replay), replay.answer.shots
        caption = Caption.of(shown, shots, unlike)
        with out.writing() as made:
            write(made, pictures(replay, shown.scene.gripper, caption, layout), shots)
    return unlike


def explain(shown: Specimen, unlike: list[str]) -> str:
    """What differs, and how this platform differs from the one that the row was made on."""
    return (
        f"The replay differs from row {shown.number}: {', '.join(unlike)}. "
        f"{agreement.compared(shown.found_by.platform, platform())}"
    )


def _unlike(shown: Specimen, replay: Replay) -> list[str]:
    if shown.outcome is Outcome.DEAD_END:
        return []
    return agreement.words(shown.row, agreement.replayed(shown.row, replay.answer))
