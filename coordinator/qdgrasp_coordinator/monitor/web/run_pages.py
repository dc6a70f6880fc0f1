"""Pages of runs: what the view in 3D asks for."""

from collections.abc import Callable

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route

from qdgrasp_coordinator.monitor.web.libraries import Library
from qdgrasp_coordinator.monitor.web.markup import html
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.keys import number

ASKERS = 16
"""So many threads ask the library; what waits for them keeps nothing else waiting."""
HIGHEST = (1 << 32) - 1
"""The last number that a row of a journal may have."""


class RunPages:
    """What a library knows of runs."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._askers = CapacityLimiter(ASKERS)

    def routes(self) -> list[BaseRoute]:
        """What is answered where."""
        run = "/api/jobs/{job}/runs/{run}"
        return [
            Route(f"{run}/curve", self.curve),
            Route(f"{run}/scene", self.scene),
            Route(f"{run}/cells", self.cells),
            Route(f"{run}/grasps/{{number}}", self.grasp),
        ]

    async def curve(self, request: Request) -> Response:
        """How a run grew that was over before anybody watched."""
        return json_of(await self.asked(lambda: self._library.curve(*_run(request))))

    async def scene(self, request: Request) -> Response:
        """What stands in the view in 3D."""
        return json_of(await self.asked(lambda: self._library.scene(*_run(request))))

    async def cells(self, request: Request) -> Response:
        """The cells of the view in 3D."""
        since = _row(request.query_params.get("from", "")) or 0
        packed = await self.asked(lambda: self._library.cells(*_run(request), since))
        return Response(packed, media_type="application/octet-stream")

    async def grasp(self, request: Request) -> Response:
        """One find."""
        row = _row(text := request.path_params["number"])
        if row is None:
            raise InputError(f"'{text[:20]}' is not the number of a row.")
        return json_of(await self.asked(lambda: self._library.grasp(*_run(request), row)))

    async def asked(self, question: Callable[[], bytes]) -> bytes:
        """What the library answers, in a thread of those that may take long."""
        return await to_thread.run_sync(question, limiter=self._askers)


def page(name: str) -> Response:
    """A page itself."""
    return HTMLResponse(html(name))


def json_of(text: bytes) -> Response:
    """JSON that holds for now alone."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type="application/json")


def _run(request: Request) -> tuple[str, str]:
    """The job and the run that are asked for."""
    return request.path_params["job"], request.path_params["run"]


def _row(text: str) -> int | None:
    """The number of a row of a journal; None where the text is none."""
    found = number(text)
    return found if found is None or found <= HIGHEST else None
