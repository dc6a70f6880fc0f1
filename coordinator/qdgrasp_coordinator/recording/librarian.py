"""The librarian: shows those who watch what is recorded, without a word to whoever records.

It is asked in threads of the bus, reads the journals as they are now, and writes nothing: no commit waits for
it.
"""

import re
import threading
from collections import OrderedDict
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Self

from qdgrasp_coordinator.analysis.legends import Legends
from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_coordinator.counts.finds import Found, to_message
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_finds import page
from qdgrasp_coordinator.recording.register import Register
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import FolderError, Refused
from qdgrasp_protocol.keys import NAME, Keys, last_chunk, number
from qdgrasp_protocol.messages import Finds

SCENES = 8
"""So many scenes are kept in memory."""


class Librarian:
    """Answers on `rec/runs`, `rec/finds` and `rec/asset` while its context lasts (docs/bus.md, keys).

    Parameters
    ----------
    path
        The job's folder, or where it is to be.
    """

    def __init__(self, bus: Bus, job: str, path: Path) -> None:
        self._bus = bus
        self._keys = Keys(job)
        self._path = path
        self._register = Register(path)
        self._legends = Legends()
        self._lock = threading.Lock()
        self._scenes: OrderedDict[str, bytes] = OrderedDict()  # by digest, as they were asked for
        self._homes: dict[str, Path] = {}  # where scenes were seen
        self._doors = ExitStack()

    def __enter__(self) -> Self:
        for pattern, answer in (
            (self._keys.entries, self.entries),
            (self._keys.finds, self.finds),
            (self._keys.recorded_asset(), self.scene),
        ):
            self._doors.enter_context(self._bus.answer(pattern, answer))
        return self

    def __exit__(self, *_: object) -> None:
        self._doors.close()

    def entries(self, query: Query) -> bytes:
        """Which runs there are, from number `from` on; or the run `run` alone, with its curve.

        Raises
        ------
        Refused
            That is no name.
        """
        if run := _parameters(query).get("run"):
            if not NAME.fullmatch(run):
                raise Refused(f"this recorder has no run '{run[:64]}'")
            return to_json(self._register.one(run))
        return to_json(self._register.page(_number(query, "from")))

    def finds(self, query: Query) -> bytes:
        """Successes of the run `run` from journal number `from` on.

        Raises
        ------
        Refused
            There is no such run, or it cannot be read.
        """
        run = _parameters(query).get("run", "")
        path = JobFolder(self._path).run_path(run)
        if not NAME.fullmatch(run) or not RunFolder.is_run(path):
            raise Refused(f"this recorder has no run '{run[:64]}'")
        try:
            with Journal.open(path) as journal:
                self._homes[journal.scene] = path
                legend = self._legends.of(RunFolder(path), journal)
                return codec.encode(_told(journal, run, *page(journal, _number(query, "from"), legend)))
        except FolderError as error:
            raise Refused(str(error)) from None

    def scene(self, query: Query) -> bytes:
        """One chunk of a scene.

        Raises
        ------
        Refused
            No run here has this scene.
        """
        digest = last_chunk(query.key)
        return chunks.answer(query, self._bundle(digest), digest)

    def _bundle(self, digest: str) -> bytes:
        """The bytes of a scene; those that were asked for last are kept."""
        with self._lock:
            payload = self._scenes.pop(digest, None) or self._read(digest)
            self._scenes[digest] = payload
            if len(self._scenes) > SCENES:
                self._scenes.popitem(last=False)
            return payload

    def _run_paths(self) -> list[Path]:
        return JobFolder(self._path).run_paths if JobFolder.is_job(self._path) else []

    def _read(self, digest: str) -> bytes:
        """The bytes of a scene, from the folder of any run that has it."""
        seen = [self._homes[digest]] if digest in self._homes else []
        for path in seen + self._run_paths():
            with suppress(FolderError):
                with Journal.open(path) as journal:
                    is_its = journal.scene == digest
                if is_its and (bundle := RunFolder(path).bundle()).digest == digest:
                    return bundle.payload
        raise Refused(f"no run here has the scene {digest[:12]}")


def _told(journal: Journal, run: str, finds: Found, upto: int) -> Finds:
    """Some finds of a journal as they travel."""
    joints, began = journal.shape.joints, journal.created
    return to_message(
        finds, upto, run=run, scene=journal.scene, began=began, rows=journal.count, joints=joints
    )


def _parameters(query: Query) -> dict[str, str]:
    """What stands behind the `?`, by name."""
    pairs = (part.partition("=") for part in re.split("[&;]", query.parameters))
    return {name: value for name, _, value in pairs}


def _number(query: Query, name: str) -> int:
    """The number that a parameter is; 0 where it is missing.

    Raises
    ------
    Refused
        It is none.
    """
    text = _parameters(query).get(name, "0")
    found = number(text)
    if found is None:
        raise Refused(f"'{text[:20]}' is no number: {name}")
    return found
