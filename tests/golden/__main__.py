"""Print differences from the golden files: `python -m tests.golden`; `--write` accepts them.

Names after that choose golden files; else it is all of them.
"""

import argparse
import sys

from tests.golden.golden_files import FILES, MAKERS, differences


def main() -> int:
    parser = argparse.ArgumentParser("python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="FILE", help=f"of {', '.join(MAKERS)}")
    parser.add_argument("--write", action="store_true", help="write them anew")
    asked = parser.parse_args()
    if strange := {*asked.names} - MAKERS.keys():
        parser.error(f"no golden file is called {', '.join(sorted(strange))}; there are {', '.join(MAKERS)}")
    differs = False
    for name in asked.names or MAKERS:
        now = MAKERS[name]()
        if found := differences(name, now):
            differs = True
            sys.stdout.write(found)
            if asked.write:
                (FILES / name).write_text(now, encoding="utf-8")
        sys.stdout.write(f"{name}: {('written' if asked.write else 'differs') if found else 'the same'}\n")
        sys.stdout.flush()
    return int(differs and not asked.write)


if __name__ == "__main__":
    sys.exit(main())
