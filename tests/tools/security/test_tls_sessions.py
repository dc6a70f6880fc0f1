"""Sessions over mutual TLS: clients that get one, and messages to those that do not."""

import shutil
import threading
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

import pytest
from tests.common import PATIENCE
from tests.fakes.job import FakeRunQueue
from tests.fakes.messages import ANN, EVE, KEYS_BY_ID, join_message
from tests.fakes.recorder import JOB
from tests.tools.security.conftest import certificate_files, encrypted_endpoint

from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.job_scheduler import JoinRequest
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_protocol import messages
from qdgrasp_protocol.errors import EndpointError, NoReply, Refused, SecurityError
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.messages import Joined
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools import security as security_folder
from qdgrasp_tools.security import SecurityFolder

LAST = 100


def test_strangers_get_no_session_and_are_told_why(secured: str, folder: Path, tmp_path: Path) -> None:
    ours, theirs = SecurityFolder(folder).authority, security_folder.create_authority(1)
    long_ago = datetime.now(UTC) - timedelta(days=2)
    tried = {
        r"it does not take the files of the worker in .* \(TLSV1_ALERT": {"signer": theirs, "trusts": ours},
        "the certificate it shows is not good": {"signer": theirs},
        "it does not take the files of the worker": {"signer": ours, "now": long_ago},
    }
    for number, (words, how) in enumerate(tried.items()):
        shown = certificate_files(tmp_path / str(number), **how)
        with pytest.raises(EndpointError, match=words):
            ZenohBus.connect(secured, 0.3, credentials=shown)
    with pytest.raises(EndpointError):
        ZenohBus.connect(secured.replace("tls/", "tcp/"), 0.3)


def test_a_router_that_is_reached_by_a_name_not_its_own_is_not_trusted(folder: Path) -> None:
    elsewhere = encrypted_endpoint().replace("127.0.0.1", "127.0.0.2")
    with (
        ZenohBus.router(elsewhere, credentials=Credentials.find(folder, Role.ROUTER)),
        pytest.raises(EndpointError, match=r"not valid for '127\.0\.0\.2'"),
    ):
        ZenohBus.connect(elsewhere, 0.3, credentials=Credentials.find(folder, Role.WORKER))


def test_a_workers_certificate_does_not_make_a_router(folder: Path, tmp_path: Path) -> None:
    """A client with a stolen worker's key cannot take the router's place."""
    forged = Path(shutil.copytree(folder, tmp_path / "forged"))
    for kind in ("pem", "key"):
        shutil.copy(folder / f"worker.{kind}", forged / f"router.{kind}")
    endpoint = encrypted_endpoint()
    with (
        ZenohBus.router(endpoint, credentials=Credentials.find(forged, Role.ROUTER)),
        pytest.raises(EndpointError, match="the certificate it shows is not good"),
    ):
        ZenohBus.connect(endpoint, 0.3, credentials=Credentials.find(folder, Role.WORKER))


def test_messages_that_are_too_large_for_their_key_are_dropped_at_the_router(secured, folder) -> None:
    key, heard, proof = "qdgrasp/v1/mugs/@recorded", SimpleQueue[int](), partial(Credentials.find, folder)
    with (
        ZenohBus.connect(secured, PATIENCE, credentials=proof(Role.RECORDER)) as recorder,
        ZenohBus.connect(secured, PATIENCE, credentials=proof(Role.COORDINATOR)) as coordinator,
        coordinator.subscribe(key, lambda sample: heard.put(len(sample.payload))),
    ):
        sizes = []
        while not sizes or sizes[-1] != LAST:
            for size in (4096, 4097, 1 << 20, 16 << 20, 20 << 20, LAST):
                recorder.put(key, bytes(size), encoding="application/octet-stream")
            sizes.append(heard.get(timeout=PATIENCE))
    assert set(sizes) <= {4096, LAST}


def test_a_link_ends_with_the_certificate_that_it_was_opened_by(secured, folder, tmp_path) -> None:
    links = SimpleQueue[bool]()
    issued = datetime.now(UTC) - timedelta(days=1) + timedelta(seconds=5)
    ours = SecurityFolder(folder).authority
    shown = certificate_files(tmp_path / "worker", ours, now=issued)
    with (
        ZenohBus.connect(secured, PATIENCE, credentials=shown) as worker,
        worker.on_link(links.put),
    ):
        assert links.get(timeout=PATIENCE) is False


def test_a_worker_joins_in_its_own_name_alone(secured: str, folder: Path) -> None:
    """Another worker's id is seen in the keys of its work; its key goes to coordinators alone."""
    proof, keys = partial(Credentials.find, folder), Keys(JOB)
    stolen, seen, joined = SimpleQueue[str](), SimpleQueue[bytes](), Joined(epoch=1, drop=[])
    over = threading.Event()

    def answer_joins() -> None:
        while not over.is_set():
            with suppress(Empty):
                if isinstance(event := service.inbox.get(timeout=0.1), JoinRequest):
                    event.answer.set_result(messages.encode(joined))

    def asks(bus: ZenohBus, **values: object) -> Joined:
        """Ask to join as Ann, until the router knows of the coordinator."""
        request = messages.encode(join_message(ANN, **values))
        while True:
            with suppress(NoReply):
                return messages.decode(bus.ask(keys.join, request, timeout=PATIENCE), Joined)

    with ExitStack() as stack:
        enter = stack.enter_context
        coordinator = enter(ZenohBus.connect(secured, PATIENCE, credentials=proof(Role.COORDINATOR)))
        ann, ear, eve = (
            enter(ZenohBus.connect(secured, PATIENCE, credentials=proof(Role.WORKER))) for _ in range(3)
        )
        enter(ear.subscribe(keys.work("*"), lambda sample: stolen.put(last_chunk(sample.key))))
        enter(ear.answer(keys.join, lambda query: seen.put(query.payload) or b""))
        queue = FakeRunQueue({})
        service = CoordinatorService(
            coordinator, Stop(), job=JOB, queue=queue, make_sink=lambda run: RowSink(run.shape)
        )
        enter(service.subscriptions)
        service.open_to_workers(1, "")
        thread = threading.Thread(target=answer_joins)
        stack.callback(thread.join)
        stack.callback(over.set)
        thread.start()
        assert asks(ann) == joined
        while stolen.empty():  # the router may tell of the subscriber later
            coordinator.put(keys.work(ANN), b"work", encoding="application/octet-stream")
        assert stolen.get() == ANN
        with pytest.raises(Refused, match=f"the id {ANN} is not that of the worker's key"):
            asks(eve, number=2**62, credit=0, key=KEYS_BY_ID[EVE])
        assert asks(ann, number=2) == joined
        assert seen.empty()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"enabled": true', '"enabled": false', "does not deny what it does not allow"),
        ('"deny"', '"allow"', "does not deny what it does not allow"),
        ('"put"', '"pud"', "is not a configuration that zenoh takes: unknown variant"),
        ("{", "[", "is not a configuration that zenoh takes"),
        ('"id": "worker gives (put)"', '"id": "x"', "Access control not enabled"),
    ],
)
def test_a_router_with_a_damaged_configuration_does_not_open(folder, tmp_path, old, new, words) -> None:
    damaged = Path(shutil.copytree(folder, tmp_path / "damaged")) / "router.json5"
    assert old in damaged.read_text()
    damaged.write_text(damaged.read_text().replace(old, new))
    with pytest.raises((EndpointError, SecurityError), match=words) as caught:
        ZenohBus.router(encrypted_endpoint(), credentials=Credentials.find(damaged.parent, Role.ROUTER))
    assert "\n" not in str(caught.value)
