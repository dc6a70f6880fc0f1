"""A process of the next version of the protocol: `python -m tests.fakes.next_version MODULE [ARGUMENTS]`."""

import importlib.util
import runpy
import sys
from pathlib import Path

NAME = "qdgrasp_protocol.messages"


def speak_next_version() -> int:
    """Load the messages with a version that is higher by one; returns it."""
    spec = importlib.util.find_spec(NAME)
    assert spec is not None
    assert spec.origin is not None
    module = importlib.util.module_from_spec(spec)
    source = Path(spec.origin).read_text(encoding="utf-8")
    line = next(line for line in source.splitlines() if line.startswith("VERSION = "))
    version = int(line.split()[2]) + 1
    sys.modules[NAME] = module
    exec(compile(source.replace(line, f"VERSION = {version}"), spec.origin, "exec"), vars(module))  # noqa: S102
    return version


if __name__ == "__main__":
    speak_next_version()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
