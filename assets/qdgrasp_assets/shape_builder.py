"""The process that builds the shape of an object, within a limit of memory.

Started as `python -m qdgrasp_assets.shape_builder TASK FOLDER OUT`, with a task as MessagePack, the folder
of its files, and the file to write: the packed shape, whole or not at all. It ends with 2 and a sentence on
standard error where no object can be made of the files, with 1 and a sentence where that may differ on
another machine, and with the process that started it. A starter that needs its time bounded kills it.
"""

import logging
import os
import sys
import warnings
from pathlib import Path

import msgspec

from qdgrasp_assets.asset_paths import write_whole
from qdgrasp_assets.object_shape import ShapeStore, build_shape, pack_shape
from qdgrasp_protocol.build_messages import ShapeTask
from qdgrasp_protocol.errors import AssetError, QdgraspError, UnreadableHere
from qdgrasp_protocol.process_limits import end_with_parent_only, limit_memory

MOST_MEMORY = 4_000_000_000  # Memory that it may have [bytes]
SIMPLIFY = "simplify it, for example with --mesh simplify=20000"
UNUSABLE, FAILED = 2, 1
"""Exit codes where no object can be made of the files, and where it cannot be made on this machine."""


def main() -> int:
    """Build the shape of the task in the first file; return the exit code."""
    end_with_parent_only()
    logging.disable()
    warnings.simplefilter("ignore")
    task_file, folder, out = map(Path, sys.argv[1:])
    task = msgspec.msgpack.decode(task_file.read_bytes(), type=ShapeTask)
    is_limit_of_task = limit_memory(MOST_MEMORY)
    try:
        payload = pack_shape(ShapeStore().kept(task.key, lambda: build_shape(task, folder)))
    except (QdgraspError, MemoryError) as error:
        is_local = isinstance(error, UnreadableHere)
        is_final, sentence = isinstance(error, AssetError) and not is_local, str(error)
        # readers of meshes name it in an error of their own
        if isinstance(error, MemoryError) or MemoryError.__name__ in sentence:
            means = f"{MOST_MEMORY / 1e9:.1f} GB of memory" if is_limit_of_task else "this worker's memory"
            is_final, sentence = is_limit_of_task, f"The mesh takes more than {means}; {SIMPLIFY}."
        sys.stderr.write(f"{sentence.replace(f'{folder}{os.sep}', '')}\n")
        return UNUSABLE if is_final else FAILED
    write_whole(out, payload)
    return 0


if __name__ == "__main__":
    sys.exit(main())
