"""The process that builds the shape of an object, within the limits of its task.

Started as `python -m qdgrasp_assets.shape_builder TASK FOLDER OUT`, with a task as MessagePack, the folder
of its files, and the file to write: a `ShapeReport`, whole or not at all. It ends with 2 and a sentence on
standard error where no object can be made of the files, and with the process that started it. A starter that
needs its time bounded by the clock kills it; CoACD, which it starts, ends with it.
"""

import logging
import os
import resource
import signal
import sys
import warnings
from pathlib import Path
from types import FrameType

import msgspec
from msgspec import Struct

from qdgrasp_assets.asset_paths import write_whole
from qdgrasp_assets.object_shape import ShapeStore, build_shape, pack_shape
from qdgrasp_assets.process_limits import end_with_parent_only, limit_memory
from qdgrasp_protocol.build_messages import ShapeTask
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.messages import Count, Number

PREPARING_SECONDS = 600  # CPU seconds that all but the convex parts may take; a minute is long
UNUSABLE = 2  # Exit code where no object can be made of the files


class ShapeReport(Struct, frozen=True, kw_only=True):
    """A shape, and the resources that building it took."""

    shape: bytes
    """As `pack_shape` returns it."""
    cpu_seconds: Number
    """CPU time of this process and those that it started."""
    memory: Count
    """Most memory that one of these processes had [bytes]."""


def build(task: ShapeTask, folder: Path, store: ShapeStore) -> ShapeReport:
    """Return the shape of a task: from the store, or built from files and put there.

    Errors are those of `build_shape`.
    """
    known = store.get(task.key)
    payload = pack_shape(known or build_shape(task, folder))
    if known is None:
        store.put(task.key, payload)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return ShapeReport(
        shape=payload,
        cpu_seconds=sum(each.ru_utime + each.ru_stime for each in used),
        memory=max(_own_peak(), used[1].ru_maxrss << 10),
    )


def _own_peak() -> int:
    """Return the most memory that this process had [bytes].

    `getrusage` counts that of the process that forked it too.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM:")), 0)


def main() -> int:
    """Build the shape of the task in the first file; return the exit code."""
    end_with_parent_only()
    logging.disable()
    warnings.simplefilter("ignore")
    task_file, folder, out = map(Path, sys.argv[1:])
    task = msgspec.msgpack.decode(task_file.read_bytes(), type=ShapeTask)
    signal.signal(signal.SIGXCPU, _end_out_of_time)
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (PREPARING_SECONDS, most))
    limit_memory(task.memory)
    try:
        built = build(task, folder, ShapeStore())
    except (AssetError, MemoryError) as error:
        # readers of meshes name it in an error of their own
        is_of_memory = isinstance(error, MemoryError) or MemoryError.__name__ in str(error)
        sentence = _too_large(f"{task.memory / 1e9:.1f} GB of memory") if is_of_memory else str(error)
        sys.stderr.write(f"{sentence.replace(f'{folder}{os.sep}', '')}\n")
        return UNUSABLE
    write_whole(out, msgspec.msgpack.encode(built))
    return 0


def _end_out_of_time(_number: int, _frame: FrameType | None) -> None:
    """End this process with a sentence, at any point."""
    sys.stderr.write(f"{_too_large(f'{PREPARING_SECONDS} s')}\n")
    sys.stderr.flush()
    os._exit(UNUSABLE)


def _too_large(means: str) -> str:
    return f"The mesh takes more than {means}; simplify it, for example with --simplify 20000."


if __name__ == "__main__":
    sys.exit(main())
