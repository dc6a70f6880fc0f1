"""Messages between a worker and its simulator, and the pipe that carries them.

Frozen structs in MessagePack. Answers come in the order of the questions, so that neither carries a number.
`BatchProgress` gathers the answers to one batch.
"""

from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import TypeAlias

import msgspec
from msgspec import Struct

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Result, Work, deflated, shorten

MAX_FRAME_SIZE = 1 << 30  # The longest message [bytes]; a greater length is an error


class SimulatorMessage(Struct, frozen=True, kw_only=True, tag=True, forbid_unknown_fields=True):
    """The root of all messages."""


class EvaluateRows(SimulatorMessage, frozen=True, kw_only=True):
    """Worker to simulator: evaluate rows of a batch."""

    scene: str
    """The digest of the scene."""
    bundle: bytes | None
    """The scene, unless the simulator has it."""
    prior: str
    n: int
    genes: int
    columns: dict[str, bytes]
    """`index`, `trial` and `genome`."""
    is_careful: bool
    """Each row is evaluated by itself, and its result sent before the next begins."""


class SimulatorReady(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it has evaluated the probes."""

    platform: dict[str, str]


class SceneLoaded(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: the scene that came with the batch is loaded."""


class PartialResult(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: the results of the next rows of the batch."""

    n: int
    joints: int = 0
    contact_slots: int = 0
    columns: dict[str, bytes] = {}
    """All of `rows.RESULT`; rows named in `failures` hold zeros."""
    failures: list[Failure] = []
    """Failures by the place of the row in this part."""
    cpu_seconds: float = 0.0


class BatchRejected(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: no row of the batch can be evaluated, with the reason."""

    reason: str


class SceneMissing(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it does not have the scene; send the batch again, with it."""


class SimulatorCrashed(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it raised this error, and ends."""

    reason: str


AnySimulatorMessage: TypeAlias = (
    EvaluateRows
    | SimulatorReady
    | SceneLoaded
    | PartialResult
    | BatchRejected
    | SceneMissing
    | SimulatorCrashed
)
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[AnySimulatorMessage] = msgspec.msgpack.Decoder(AnySimulatorMessage)


class MessageConnection:
    """One end of a pipe for these messages."""

    def __init__(self, end: "Connection[bytes, bytes]") -> None:
        self._end = end

    def send(self, message: SimulatorMessage) -> None:
        """Send a message, waiting while the other side is behind; an OSError if that is closed."""
        self._end.send_bytes(_ENCODER.encode(message))

    def receive(self) -> AnySimulatorMessage | None:
        """The next message; None where the other side is closed, a MessageError if it is not one."""
        try:
            return _DECODER.decode(self._end.recv_bytes(MAX_FRAME_SIZE))
        except (EOFError, ConnectionResetError):
            return None
        except (OSError, msgspec.MsgspecError) as error:
            raise MessageError(f"not a message: {str(error)!a}") from None

    def close(self) -> None:
        """Close this end; closing twice is allowed."""
        self._end.close()


@dataclass(eq=False)
class BatchProgress:
    """A batch of a job at the simulator, or waiting for it."""

    job: str
    work: Work
    is_careful: bool = False
    """Its rows are evaluated one by one: a simulator ended during this batch."""
    is_loading: bool = False
    """Its scene was sent along, and is not loaded yet."""
    done: int = 0
    """Number of its rows that are known."""
    cpu_seconds: float = 0.0
    _parts: list[PartialResult] = field(default_factory=list)
    _failures: list[Failure] = field(default_factory=list)

    @property
    def is_done(self) -> bool:
        """True if all rows are known."""
        return self.done >= self.work.n

    def request(self, bundle: bytes | None) -> EvaluateRows:
        """Return the request to evaluate the rows that are not known yet, with the scene if given."""
        work = self.work
        self.is_loading = bundle is not None
        columns = {name: blob[self.done * (len(blob) // work.n) :] for name, blob in work.columns.items()}
        return EvaluateRows(
            scene=work.scene,
            bundle=bundle,
            prior=work.prior,
            n=work.n - self.done,
            genes=work.genes,
            columns=columns,
            is_careful=self.is_careful,
        )

    def add(self, part: PartialResult) -> None:
        """Take the results of the next rows."""
        self._failures += [
            Failure(row=self.done + failed.row, reason=failed.reason) for failed in part.failures
        ]
        self._parts.append(part)
        self.done += part.n
        self.cpu_seconds += part.cpu_seconds

    def on_crash(self, reason: str) -> None:
        """Note that the simulator ended during this batch.

        If it was loading the scene, all rows fail. If it went row by row, the first that is not known fails;
        else the faulty row is not known, and rows are tried one by one.
        """
        if self.is_loading:
            self.fail_all(f"{reason} while it loaded the scene")
        elif self.is_careful or self.done == self.work.n - 1:
            self.add(PartialResult(n=1, failures=[Failure(row=0, reason=shorten(reason))]))
        self.is_careful = True

    def fail_all(self, reason: str) -> None:
        """Note that no row can be evaluated, for one reason."""
        n = self.work.n
        self._parts, self.done = [], n
        self._failures = [Failure(row=row, reason=shorten(reason)) for row in range(n)]

    def result(self, wid: str, key: bytes) -> Result:
        """Return the answer to the batch, by a worker with its key."""
        work = self.work
        shape = next((part for part in self._parts if part.columns), PartialResult(n=1))
        return Result(
            epoch=work.epoch,
            run=work.run,
            generation=work.generation,
            batch=work.batch,
            attempt=work.attempt,
            wid=wid,
            key=key,
            n=work.n,
            joints=shape.joints,
            contact_slots=shape.contact_slots,
            columns=deflated(
                {name: self._column(name, len(blob) // shape.n) for name, blob in shape.columns.items()}
            ),
            cpu_seconds=self.cpu_seconds,
            failures=self._failures,
        )

    def _column(self, name: str, width: int) -> bytes:
        """One column of all rows, `width` bytes each; a row that ended its simulator holds zeros."""
        return b"".join(part.columns.get(name, bytes(width * part.n)) for part in self._parts)
