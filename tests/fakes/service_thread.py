"""A service that runs in a thread of its own."""

import signal
import threading
from collections.abc import Callable

from tests.common import PATIENCE

from qdgrasp_protocol.errors import QdgraspError
from qdgrasp_protocol.process import Stop


class ServiceThread:
    """A service in a thread, until it ends or is asked to stop."""

    def __init__(self, run: Callable[[], object], stop: Stop) -> None:
        self.error: Exception | None = None
        self._run, self._stop = run, stop
        self._thread = threading.Thread(target=self._guard, daemon=True)
        self._thread.start()

    def _guard(self) -> None:
        try:
            self._run()
        except Exception as error:  # noqa: BLE001 - the test looks at it
            self.error = error

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def leave(self, number: int = signal.SIGTERM) -> None:
        """Ask it to stop."""
        self._stop.set(number)

    def ends(self) -> None:
        """Wait for its end, with an error of ours or with none."""
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()
        assert self.error is None or isinstance(self.error, QdgraspError), self.error
