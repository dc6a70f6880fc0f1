"""Bytes of a stranger on the bus of a running job that are no message are dropped."""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

from tests.common import PATIENCE, own_endpoint, wait_for
from tests.fuzz.consumers import CONSUMERS, KINDS, seeds
from tests.fuzz.fuzzer import Mutator, corpus
from tests.system.commands import LONG, end_of, held, pids, processes_of

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import NoReply, QdgraspError, Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.zenoh_bus import ZenohBus

KEYS = Keys("run")
CHANGED = 60  # messages of each kind, besides the corpus
GROWTH = 64 << 20  # bytes
ENCODINGS = {kind.wire_name: messages.encoding(kind) for kind in KINDS}


def refused(kind: str) -> Iterator[bytes]:
    """The corpus, and changed messages of a kind, as far as they are none."""
    mutator, start = Mutator(7, list(seeds().values())), seeds()[kind]
    for payload in (*corpus()[kind], *(mutator(start) for _ in range(CHANGED))):
        try:
            CONSUMERS[kind](payload)
        except QdgraspError:
            yield payload


class Stranger:
    """A client on a bus without access list that knows a worker of the job."""

    def __init__(self, bus: Bus, wid: str) -> None:
        self._bus = bus
        self._put_on = {
            "work": KEYS.work(wid),
            "control": KEYS.ctl(wid),
            "result": KEYS.result(wid),
            "recorded": KEYS.recorded,
            "recordable": KEYS.outcome(1),
            "platform": KEYS.outcome(1),
            "jobfigures": KEYS.stat("job"),
            "sign": KEYS.stat(f"worker/{wid}"),
        }
        self._ask_on = {"join": KEYS.join, "order": KEYS.control, "open": KEYS.open, "log": KEYS.log}

    def rage(self) -> int:
        """Send all messages on all keys; returns their number."""
        count = 0
        for kind, key in self._put_on.items():
            for payload in refused(kind):
                for encoding in (ENCODINGS.get(kind, "application/json"), "text/plain"):
                    self._bus.put(key, payload, encoding=encoding)
                    count += 1
        for kind, key in self._ask_on.items():
            for payload in refused(kind):
                with suppress(Refused, NoReply):
                    self._bus.ask(key, payload, timeout=1.0)
                count += 1
        pieces = ("", "i=", "i=-1", "i=²", "i=" + "9" * 5000, "i=1;i=2", "j=0")
        pages = ("run=..", "run=run&from=²", "run=run&from=" + "9" * 5000, "&;=;&", "run=run" * 5000)
        bad = [(KEYS.asset("ab" * 32), pieces), (KEYS.recorded_asset("ab" * 32), pieces)]
        for key, selectors in (*bad, (KEYS.finds, pages), (KEYS.entries, pages)):
            for parameters in selectors:
                with suppress(Refused, NoReply):
                    self._bus.ask(key, parameters=parameters, timeout=1.0)
        coordinators = KEYS.root + "/live/coord/"
        for key in (coordinators + "²", coordinators + "9" * 5000, KEYS.worker_token("x")):
            with self._bus.token(key):
                pass
        return count


def memory(pid: int) -> int:
    """Memory of a process [bytes]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


def dropped(log: Path) -> list[int]:
    """Numbers of dropped messages in a process's log."""
    return [int(number) for number in re.findall(r"dropped=(\d+)", log.read_text())]


def test_a_stranger_changes_nothing_and_takes_nothing_down(qdgrasp, reference) -> None:
    endpoint, seen = own_endpoint(), SimpleQueue[str]()
    running = qdgrasp.start("run", *LONG, "--workers", 1, "--listen", endpoint, "--out", "run")
    with ZenohBus.connect(endpoint, PATIENCE) as bus:
        with bus.watch(KEYS.worker_token(), lambda key, _alive: seen.put(last_chunk(key))):
            stranger = Stranger(bus, seen.get(timeout=PATIENCE))
        (worker,) = pids(running, "worker")
        (simulator,) = wait_for(lambda: processes_of(worker).values(), "a simulator")
        with held(simulator):  # so that the job does not end meanwhile
            before = processes_of(running.pid)
            sizes = {name: memory(pid) for name, pid in before.items()}
            assert stranger.rage() > 1000
            assert processes_of(running.pid) == before
            for name, pid in before.items():
                assert memory(pid) < sizes[name] + GROWTH
    out, said = end_of(running)
    assert "started again" not in out + said
    logs = qdgrasp.home / "run" / "logs"
    for name in ("coordinator", "recorder", "worker-0"):
        told = dropped(logs / f"{name}.log")
        assert max(told) >= 64
        assert len(told) < 20
        assert "Traceback" not in (logs / f"{name}.log").read_text()
    assert qdgrasp.digest("run") == reference[1]
