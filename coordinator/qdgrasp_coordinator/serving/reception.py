"""The reception: answers what others ask, in threads of the bus."""

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.serving.inbox import Inbox, JoinRequest, OrderRequest
from qdgrasp_protocol import chunks, codec
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import MessageError, NoReply, Refused
from qdgrasp_protocol.keys import last_chunk
from qdgrasp_protocol.messages import Done, Join, Order, short

PATIENCE = 5.0  # seconds that a question waits for the coordinator's one thread

T = TypeVar("T")


class Reception:
    """Hands questions over to the coordinator's one thread, and scenes out.

    Parameters
    ----------
    scene
        The scene of a digest, or None; called in any thread.
    """

    def __init__(self, inbox: Inbox, scene: Callable[[str], Bundle | None]) -> None:
        self._inbox = inbox
        self._scene = scene

    def join(self, query: Query) -> bytes:
        """Hand a request to join over, and wait for the answer.

        Raises
        ------
        Refused
            It is no such request, or is refused.
        NoReply
            The coordinator is busy.
        """
        try:
            request = JoinRequest(codec.decode(query.payload, Join))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        return _awaited(request.answer)

    def order(self, query: Query) -> bytes:
        """Hand an order over, and wait for what happened.

        Raises
        ------
        Refused
            It is no such order, or cannot be obeyed.
        NoReply
            The coordinator is busy.
        """
        try:
            request = OrderRequest(codec.decode(query.payload, Order))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        return codec.encode(Done(words=short(_awaited(request.answer))))

    def scene(self, query: Query) -> bytes:
        """One chunk of a scene.

        Raises
        ------
        Refused
            No run in progress has this scene.
        """
        digest = last_chunk(query.key)
        scene = self._scene(digest)
        if scene is None:
            raise Refused(f"no run in progress has the scene {digest[:12]}")
        return chunks.answer(query, scene.payload, digest)


def _awaited(answer: "Future[T]") -> T:
    try:
        return answer.result(PATIENCE)
    except TimeoutError:
        raise NoReply("the coordinator is busy") from None
