"""Server-sent events: the state of all jobs twice a second, made once for all browsers.

A browser takes the newest frame whenever it has taken the one before: a slow one misses frames, a stuck one
is dropped, and neither makes anything wait or grow. While no browser watches, nothing is made.
"""

import asyncio
import zlib
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import NamedTuple

from starlette.responses import StreamingResponse
from starlette.types import Message, Receive, Scope, Send

INTERVAL = 0.5  # seconds between frames
STUCK_SECONDS = 15.0  # seconds after which a browser that takes nothing is dropped
MAX_BROWSERS = 64  # So many browsers at most
GZIP_HEADER = b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\xff"
"""Where a gzip stream begins (RFC 1952); what follows here are blocks, without an end."""


class EventFrame(NamedTuple):
    """A server-sent event, in bytes."""

    number: int
    plain: bytes
    packed: bytes
    """The same in blocks of DEFLATE that lean on nothing before them: they go into any gzip stream."""

    @classmethod
    def of(cls, number: int, state: bytes) -> "EventFrame":
        """The event that tells a state, which is one line."""
        plain = b"id: %d\ndata: %b\n\n" % (number, state)
        packer = zlib.compressobj(5, zlib.DEFLATED, -zlib.MAX_WBITS)
        return cls(number, plain, packer.compress(plain) + packer.flush(zlib.Z_FULL_FLUSH))


class Broadcast:
    """Frames for all who watch.

    Parameters
    ----------
    state
        Gives what is to be shown, in one line; it is called in a thread.
    interval
        Seconds between frames.
    """

    def __init__(self, state: Callable[[], bytes], interval: float = INTERVAL) -> None:
        self.watchers = 0
        self._state = state
        self._interval = interval
        self._frame: EventFrame | None = None
        self._news = asyncio.Event()
        self._maker: asyncio.Task[None] | None = None
        self._is_over = False

    @property
    def is_full(self) -> bool:
        """Whether nobody more may watch."""
        return self.watchers >= MAX_BROWSERS

    async def frames(self) -> AsyncIterator[EventFrame]:
        """Frames from now on, until the broadcast is over; always the newest."""
        self.watchers += 1
        try:
            last = 0
            if not self._maker:  # what there is was made for those who have left
                last = self._frame.number if self._frame else 0
                self._maker = asyncio.create_task(self._make(last))
            while not self._is_over:
                if self._frame and self._frame.number > last:
                    last = self._frame.number
                    yield self._frame
                else:
                    await self._news.wait()
        finally:
            self.watchers -= 1

    def end(self) -> None:
        """Let all who watch go."""
        self._is_over = True
        self._news.set()

    async def _make(self, number: int) -> None:
        try:
            while self.watchers and not self._is_over:
                number += 1
                self._frame = EventFrame.of(number, await asyncio.to_thread(self._state))
                self._news.set()
                self._news = asyncio.Event()
                await asyncio.sleep(self._interval)
        finally:
            self._maker = None


class EventStream(StreamingResponse):
    """The answer to a browser that watches: server-sent events without an end."""

    media_type = "text/event-stream"

    def __init__(self, broadcast: Broadcast, packed: bool) -> None:
        headers = {"Cache-Control": "no-store", "Vary": "Accept-Encoding", "X-Accel-Buffering": "no"}
        if packed:
            headers["Content-Encoding"] = "gzip"
        super().__init__(_body(broadcast, packed), headers=headers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send frames until the browser is gone, or stuck."""

        async def patiently(message: Message) -> None:
            async with asyncio.timeout(STUCK_SECONDS):
                await send(message)

        with suppress(TimeoutError):
            await super().__call__(scope, receive, patiently)


async def _body(broadcast: Broadcast, packed: bool) -> AsyncIterator[bytes]:
    yield GZIP_HEADER if packed else b"retry: 1000\n\n"
    async for frame in broadcast.frames():
        yield frame.packed if packed else frame.plain
