"""A visit: one connection to the page, which is to ask for something soon or to make room."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

SOON = 10.0
"""So long a connection may take to send its first request [s]."""
GUESTS = 256
"""So many connections may come from one address, half of all that there may be."""


class Visit(H11Protocol):
    """A connection that is closed where nothing is asked on it, or too many come from its address."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in H11Protocol: over TCP
        """Begin; whoever has many already is shut out alone."""
        super().connection_made(transport)
        if self.others >= GUESTS:
            transport.abort()
        else:
            self._deadline = self.loop.call_later(SOON, self.leave)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        super().connection_lost(exc)
        if self._deadline:
            self._deadline.cancel()

    @property
    def others(self) -> int:
        """How many other connections there are from this address."""
        host = self.client and self.client[0]
        visits = [visit for visit in self.connections if isinstance(visit, Visit) and visit is not self]
        return sum(1 for visit in visits if visit.client and visit.client[0] == host)

    def leave(self) -> None:
        """Make room, unless something was asked."""
        if self.cycle is None:
            self.transport.close()
