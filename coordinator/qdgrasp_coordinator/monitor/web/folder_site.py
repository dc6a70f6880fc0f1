"""The site of jobs whose folders are at hand: their runs, and what was found in each."""

import msgspec
from msgspec import Struct
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from qdgrasp_coordinator.monitor.collection import Collection
from qdgrasp_coordinator.monitor.folder_records import FolderRecords
from qdgrasp_coordinator.monitor.web.exhibits import Exhibits
from qdgrasp_coordinator.monitor.web.run_pages import RunPages, json_of, page
from qdgrasp_protocol.printable import printable


class Listed(Struct, frozen=True):
    """A job of a collection."""

    job: str
    """Its name there."""
    folder: str
    """Its path, to be read by a person."""
    runs: list[str]
    """The names of its runs that were begun."""


class FolderSite:
    """A `Site`."""

    def __init__(self, collection: Collection) -> None:
        self._collection = collection
        self._runs = RunPages(Exhibits(FolderRecords(collection)))

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        return [Route("/", self.page), Route("/api/jobs", self.jobs), *self._runs.routes()]

    def end(self) -> None:
        """Nobody waits for anything."""

    def page(self, request: Request) -> Response:
        """The page itself."""
        return page("view")

    async def jobs(self, request: Request) -> Response:
        """All jobs (`Listed`), and which runs they have now."""
        return json_of(await self._runs.asked(self._listed))

    def _listed(self) -> bytes:
        return msgspec.json.encode([
            Listed(name, printable(str(one.folder.path)), list(one.runs))
            for name, one in self._collection.jobs.items()
        ])  # fmt: skip
