"""Messages that are not of the protocol: counted, dropped, and told of without filling a log."""

import structlog

log = structlog.get_logger()


class Drops:
    """How many messages were dropped; the first, second, fourth, eighth ... is told of."""

    def __init__(self) -> None:
        self.count = 0

    def note(self, key: str, reason: object) -> None:
        """Count a message that is dropped for a reason."""
        self.count += 1
        if self.count & (self.count - 1) == 0:
            log.warning("dropped a message", key=key[:MOST], reason=str(reason), dropped=self.count)


MOST = 200
"""The most characters of a key that are told."""
