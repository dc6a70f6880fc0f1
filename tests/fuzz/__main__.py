"""A million changed messages: `make fuzz`, or `python -m tests.fuzz --messages N --seed S`."""

import argparse
import hashlib
import sys
import time

from tests.fuzz.fuzzer import CORPUS, run

SHOWN = 10


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000, help="how many (default: 1000000)")
    parser.add_argument("--seed", type=int, default=0, help="of the changes (default: 0)")
    asked = parser.parse_args()
    began = time.monotonic()
    result = run(asked.messages, asked.seed)
    sys.stdout.write(
        f"{result.messages} messages of seed {asked.seed} in {time.monotonic() - began:.0f} s: "
        f"{result.taken.total()} were good still, {result.refused.total()} refused {dict(result.refused)}, "
        f"{len(result.escaped)} errors that are not ours; the slowest took {1e3 * result.slowest:.0f} ms, "
        f"memory grew by {result.growth >> 10} KiB after the first tenth.\n"
    )
    for kind, payload, trace in result.escaped[:SHOWN]:
        path = CORPUS / f"{kind}-{hashlib.sha256(payload).hexdigest()[:12]}.bin"
        path.write_bytes(payload)
        sys.stderr.write(f"\n{path}\n{trace}\n")
    sys.exit(bool(result.escaped))


if __name__ == "__main__":
    main()
