"""How the lines of the pages are run here: what is cut, what stands in for what, and what is not run."""

import re

ELSEWHERE = {
    r"make ": "Make's targets are what `make` itself, CI and the tests run",
    r"python3\.11 -m venv": "installs the package from the network",
    r"\. \.venv/bin/activate": "enters the environment, in which tests are already",
    r"python -m tests\.": "runs for minutes to hours; the modules have tests of their own",
    r"systemctl ": "needs systemd and root; the units have tests of their own (tests/deploy)",
    r".*\bsbatch ": "needs Slurm; the scripts have tests of their own (tests/deploy)",
    r".*\bdocker ": "needs Docker and the network; the files have tests of their own (tests/deploy)",
    r"kubectl ": "needs a cluster; the objects have tests of their own (tests/deploy)",
    r"python examples/own_optimiser\.py \S+ tcp/": "needs a router with workers; tests/examples has both",
    r"ssh ": "needs another machine",
    r"qdgrasp asset fetch": "fetches gigabytes from the network; it has tests with a server of their own",
    r"qdgrasp campaign deploy/campaigns/paper(-medium)?\.toml(?! --list)": "takes days",
}
"""What is not run, as a pattern of a line's beginning, and why. Lines of ours are parsed all the same."""

LONG = re.compile(
    r"qdgrasp (bench|campaign|analyse|rerank|verify|security check|jobs|pause|continue|drain|cancel)"
    r"|qdgrasp-(router|coordinator|recorder|worker|monitor)"
    r"|qdgrasp run .*(spec\.toml|--protocol robust|--workers 0|my_hand)"
    r"|qdgrasp resume .*--evaluations|qdgrasp info runs/paper-small"
    r"|python examples/own_"
    r"|curl "
)
"""What takes longer than the others: `make test-docs` and `make test-slow` run it, `make test` does not."""

SECONDS = 400.0
"""A command that takes longer fails."""

CUTS: tuple[tuple[str, str], ...] = (
    (r"(--protocol robust .*)--evaluations \d+", r"\1--evaluations 12"),
    (r"--top \d+", "--top 2"),
    (r"(qdgrasp-worker .*)--workers \d+", r"\1--workers 1"),
    (r"(qdgrasp bench.*)--workers \d+", r"\1--workers 2"),
    (r"--sample \d+", "--sample 5"),
    (r"--pin --grace \d+", "--pin --grace 1"),
    # CoACD takes minutes for that hand; tests/worker/test_own_hands.py mends it
    (r"gripper new xarm/\S+ (.*)-o \S+ --mend", r"gripper new arched.urdf \1-o arched.toml --mend"),
    (r"^qdgrasp bench", "qdgrasp bench --seconds 0.2"),
    (r"ycb_mug", "mug"),
    (r"security init security --host router", "security init for-containers --host 127.0.0.1"),
    (r"^(qdgrasp security add security \w+ (\S+))", r"\1 --host 127.0.0.1 && cp -r security/\2 \2"),
    (r"--security lab-7", "--security {lab}"),
    (r"--workers 0 --listen tls/0\.0\.0\.0:7448", "--workers 1 --listen {other}"),
    (r"^(curl .*)$", r"until \1; do sleep 0.2; done"),
    (r"--host node7", "--host {hostname}"),
    (r"--host (head|router)\b", "--host 127.0.0.1"),
    (r"--connect tls/a:7447,tls/b:7447", "--connect {tls}"),
    (r"--listen tls/0\.0\.0\.0:7447 --connect tls/b:7447", "--listen {tls}"),
    (r"tls/(head|localhost|0\.0\.0\.0|a|b):\d+", "{tls}"),
    (r"tcp/127\.0\.0\.1:7447", "{tcp}"),
    (r"127\.0\.0\.1:8080", "{web}"),
    (r"localhost:8080", "{web}"),
)
"""Patterns of a line, and what is run instead of what they match."""

DEFAULTS: tuple[tuple[str, str, str], ...] = (
    (r"qdgrasp (run|optimise) (?!.*(--evaluations|spec\.toml))", "--evaluations", "60"),
    (r"qdgrasp (run|resume|campaign|rerank|evaluate|verify) (?!.*(--workers|--list))", "--workers", "1"),
    (r"qdgrasp run (?=.*--workers 0)(?!.*--listen)", "--listen", "{tcp}"),
    (r"qdgrasp (run|resume|campaign|rerank) (?!.*--list)", "--listen", "{own}"),
    (r"qdgrasp (jobs|pause|continue|drain|cancel)\b(?!.*--connect)", "--connect", "{tcp}"),
    (r"qdgrasp-(monitor|worker)\b(?!.*--connect)", "--connect", "{tcp}"),
    (r"qdgrasp view (?!.*--no-open)", "--no-open", ""),
    (r"qdgrasp render (?!.*--size)", "--size", "320x240"),
)
"""What is added to lines that a pattern matches: a budget, an endpoint of its own, a small size."""

SERVICES: dict[str, str] = {
    r"qdgrasp-router": "listening",
    r"qdgrasp-coordinator": "connected|listening",
    r"qdgrasp-recorder": "",
    r"qdgrasp-worker": "",
    r"qdgrasp-monitor.*--web": r"http://",
    r"qdgrasp-monitor(?!.*--once)": "",
    r"qdgrasp view": r"http://",
    r"qdgrasp (run|campaign) .*--workers 0": "listening on",
    r"python examples/own_evaluator\.py": "",
}
"""Lines that go on until they are stopped, and what they say when they are ready; nothing: they say nothing
that is waited for."""

JOBS = r"qdgrasp-coordinator|qdgrasp (run|campaign)"
"""Of these the ones that end by themselves, when their job is done."""


def reason(text: str) -> str:
    """Why a line is not run here; empty: it is."""
    return next((why for pattern, why in ELSEWHERE.items() if re.match(pattern, text)), "")


def budget(evaluations: int) -> int:
    """A budget that is cut, and in the order of those that were asked for."""
    return 60 + evaluations // 2500


def cut(text: str, places: dict[str, str]) -> str:
    """The line that is run: budgets cut, machines and ports replaced by what there is here."""
    text = re.sub(r"--evaluations (\d+)", lambda found: f"--evaluations {budget(int(found[1]))}", text)
    for pattern, instead in CUTS:
        text = re.sub(pattern, instead, text)
    end = re.search(r"[|>]|$", text)
    assert end is not None
    head, rest = text[: end.start()], text[end.start() :]
    for pattern, flag, value in DEFAULTS:
        if re.match(pattern, head):
            head = f"{head.rstrip()} {flag} {value}".rstrip() + " "
    text = (head + rest).strip()
    for name, place in places.items():
        text = text.replace(f"{{{name}}}", place)
    return text


def service(text: str) -> str | None:
    """What a line that goes on until it is stopped says when it is ready; None: it ends by itself."""
    return next((ready for pattern, ready in SERVICES.items() if re.match(pattern, text)), None)
