"""`qdgrasp pause`, `continue`, `cancel` and `drain`: what may be done to a job while it goes on."""

from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.cli.asking import nobody, place, session
from qdgrasp_coordinator.monitor.overview import overview
from qdgrasp_protocol import codec, flags
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import InputError, NoReply, Refused, UnknownName
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Done, Order
from qdgrasp_protocol.printable import printable

Job = Annotated[str, typer.Argument(metavar="JOB", help="The job's name; `qdgrasp jobs` lists them.")]


def pause(job: Job, connect: flags.Connect = None, security: flags.Security = None) -> None:
    """Hand out no more work of a job until `qdgrasp continue`; what is out still counts.

    What a run finds does not depend on it. A coordinator that is started again goes on by itself.

    Example: qdgrasp pause mugs
    """
    order(job, place(connect, security), security, Order(act="pause"))


def continue_(job: Job, connect: flags.Connect = None, security: flags.Security = None) -> None:
    """Let a paused job go on.

    Example: qdgrasp continue mugs
    """
    order(job, place(connect, security), security, Order(act="continue"))


def cancel(job: Job, connect: flags.Connect = None, security: flags.Security = None) -> None:
    """End a job before it is done: what is recorded stays, and can be gone on with.

    Its coordinator ends with exit code 0. A `qdgrasp run` or `campaign` that started it ends with 1, because
    the job is not done, and names the command that goes on.

    Example: qdgrasp cancel mugs
    """
    order(job, place(connect, security), security, Order(act="cancel"))


def drain(
    job: Job,
    worker: Annotated[
        str | None, typer.Option(metavar="WID", help="A worker's id, or how it begins; see `jobs --json`.")
    ] = None,
    host: Annotated[str | None, typer.Option(help="Every worker on this host.")] = None,
    connect: flags.Connect = None,
    security: flags.Security = None,
) -> None:
    """Have workers finish the batches at hand and leave a job.

    Example: qdgrasp drain mugs --host node7
    """
    if (worker is None) == (host is None):
        raise InputError("Whom is the job to do without? Name a worker with --worker, or a host with --host.")
    if worker is not None and not (worker and set(worker) <= set("0123456789abcdef") and len(worker) <= 32):
        raise InputError(f"'{worker}' is no worker's id: 32 hexadecimal digits, or the first few of them.")
    order(job, place(connect, security), security, Order(act="drain", worker=worker or "", host=host or ""))


def order(job: str, endpoint: str, security: Path | None, what: Order) -> None:
    """Tell a job's coordinator what to do, and say what happened.

    Raises
    ------
    UnknownName
        There is no such job.
    InputError
        It cannot be done.
    """
    with session(endpoint, security) as bus:
        try:
            answer = bus.ask(Keys(job).control, codec.encode(what))
        except Refused as refusal:
            raise InputError(f"Nothing was done: {refusal}.") from None
        except NoReply:
            raise _nobody(bus, job, endpoint) from None
    typer.echo(printable(codec.decode(answer, Done).words))


def _nobody(bus: Bus, job: str, endpoint: str) -> InputError:
    """Why no coordinator of a job answers."""
    known = [view.meta.job for view in overview(bus)]
    if not known:
        return InputError(nobody(endpoint))
    return UnknownName("job", job, known)
