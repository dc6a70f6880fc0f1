"""The doors: what a coordinator hears, answers and shows on the bus, as long as they are open.

What comes goes into the inbox, or to the reception, in threads of the bus.
"""

from contextlib import ExitStack
from typing import Self

from qdgrasp_coordinator.serving.display import Display
from qdgrasp_coordinator.serving.inbox import Inbox, LinkChange, TokenChange
from qdgrasp_coordinator.serving.reception import Reception
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.keys import Keys


class Doors:
    """The doors of one coordinator; a context manager that closes those that were opened."""

    def __init__(self, bus: Bus, keys: Keys, inbox: Inbox, reception: Reception, display: Display) -> None:
        self._bus = bus
        self._keys = keys
        self._inbox = inbox
        self._reception = reception
        self._display = display
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def open(self) -> None:
        """Open to recorders, and to whoever watches or administers the job."""
        enter, bus, keys = self._stack.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.recorded, self._inbox.put))
        enter(bus.watch(keys.recorder_token(), self._token_changed))
        enter(bus.answer(keys.control, self._reception.order))
        for shown in (keys.stat(), keys.meta, keys.recent):
            enter(bus.show(shown, self._display.values))

    def open_to_workers(self, epoch: int) -> None:
        """Open for results, joins and scenes, and at last put the token up that invites workers."""
        enter, bus, keys = self._stack.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.result(), self._inbox.put))
        enter(bus.subscribe(keys.stat("worker/*"), self._inbox.put))
        enter(bus.answer(keys.join, self._reception.join))
        enter(bus.answer(keys.asset(), self._reception.scene))
        enter(bus.watch(keys.worker_token(), self._token_changed))
        enter(bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        enter(bus.watch(keys.coordinator_token(), self._token_changed))
        enter(bus.token(keys.coordinator_token(epoch)))

    def _token_changed(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))
