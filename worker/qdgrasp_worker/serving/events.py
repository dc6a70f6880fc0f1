"""What a worker hears of besides messages, and waits for in its inbox."""

from dataclasses import dataclass
from queue import SimpleQueue
from typing import TypeAlias

from qdgrasp_protocol.bus import Sample
from qdgrasp_worker.serving.errands import Return
from qdgrasp_worker.serving.simulator import News


@dataclass(frozen=True)
class CoordinatorSeen:
    """A coordinator's token appeared or vanished."""

    key: str
    is_alive: bool


@dataclass(frozen=True)
class LinkChanged:
    """A transport of this session came up or went down."""

    is_up: bool


@dataclass(frozen=True)
class Asked:
    """The process is asked to stop."""


Event = Sample | CoordinatorSeen | LinkChanged | Asked | Return | News
Inbox: TypeAlias = "SimpleQueue[Event]"
