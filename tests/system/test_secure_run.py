"""A job over mutual TLS: each process with the certificate of its role alone, through a router of its own."""

import signal
from pathlib import Path

from tests.endpoints import own_endpoint
from tests.system.commands import PATIENCE, SMALL, Commands, wait_for

from qdgrasp_coordinator.security.folder import SecurityFolder
from qdgrasp_protocol.credentials import Role

MODULES = {
    "router": "qdgrasp_coordinator.cli.router",
    "coordinator": "qdgrasp_coordinator.cli.coordinator",
    "recorder": "qdgrasp_coordinator.cli.recorder",
    "worker": "qdgrasp_worker.cli",
}


def test_a_run_over_encrypted_links_records_the_same_bytes(
    qdgrasp: Commands, reference: tuple[Path, str, dict]
) -> None:
    folder, digest, _ = reference
    home = SecurityFolder.create(qdgrasp.home / "security", hosts=["127.0.0.1"], days=1)
    nodes = {name: home.add(Role(name), name, hosts=["127.0.0.1"], days=1) for name in MODULES}
    endpoint = own_endpoint().replace("tcp/", "tls/")
    job = ("--job", "run", "--connect", endpoint)
    arguments = {
        "router": ("--listen", endpoint),
        "coordinator": (folder / "spec.toml", *job),
        "recorder": ("--out", "run", *job),
        "worker": job,
    }
    processes = {
        name: qdgrasp.start(*arguments[name], "--security", nodes[name], module=MODULES[name])
        for name in MODULES
    }
    _, said = processes["coordinator"].communicate(timeout=PATIENCE)
    assert processes["coordinator"].returncode == 0, said
    for name in ("worker", "recorder", "router"):
        processes[name].send_signal(signal.SIGTERM)
        assert processes[name].wait(PATIENCE) == 128 + signal.SIGTERM
    assert qdgrasp.digest("run") == digest


def test_jobs_are_seen_and_cancelled_with_the_admins_certificate_and_no_other(qdgrasp: Commands) -> None:
    home = SecurityFolder.create(qdgrasp.home / "security", hosts=["127.0.0.1"], days=1)
    monitor = home.add(Role.MONITOR, "screen", hosts=["127.0.0.1"], days=1)
    endpoint = own_endpoint().replace("tcp/", "tls/")
    everywhere = endpoint.replace("127.0.0.1", "0.0.0.0")  # noqa: S104 - links are encrypted
    flags = ("--workers", 0, "--listen", everywhere, "--out", "mugs")
    running = qdgrasp.start("run", *SMALL, *flags, QDGRASP_SECURITY=str(home.path))
    ask = ("jobs", "--json", "--connect", endpoint)

    def jobs() -> list[str]:
        said = qdgrasp(*ask, "--security", home.path)
        return [job["meta"]["job"] for job in said.json["jobs"]] if said.code == 0 else []

    wait_for(lambda: jobs() == ["mugs"], "the job")
    refused = qdgrasp("cancel", "mugs", "--connect", endpoint, "--security", monitor)
    assert (refused.code, "lacks admin.pem and admin.key" in refused.err) == (2, True)
    done = qdgrasp("cancel", "mugs", "--connect", endpoint, "--security", home.path)
    assert done.code == 0, done.err
    running.communicate(timeout=PATIENCE)
