"""Messages of builds: a worker builds the shape of an object from files by their content.

A shape is an object's mesh, its convex parts and surface points, as scenes hold them (docs/bus.md).
"""

import hashlib
import zlib
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from qdgrasp_protocol.messages import BatchId, Count, Digest, Message, Number, ShownKey, Text, Wid


class MeshPreparation(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Changes of a mesh file before it is an object: remeshed or its hull, then simplified."""

    simplify: Annotated[int, Meta(ge=20, le=500_000)] | None = None
    """Most triangles; None: as many as there are."""
    remesh: bool = False
    """A new closed surface around the shapes in the file."""
    hull: bool = False
    """Its convex hull in place of the mesh."""
    glued: bool = False
    """Bodies that are apart are meant to be one rigid object."""
    geometry: Annotated[str, Meta(max_length=200)] = ""
    """Only the geometry of this name in the file."""
    largest: bool = False
    """Only the largest body."""
    fill: bool = False
    """Small holes and flat rims are filled."""

    @property
    def words(self) -> tuple[str, ...]:
        """The changes, for the provenance."""
        named, fewer = f"geometry {self.geometry}", f"simplified to {self.simplify} triangles"
        said = {named: self.geometry, "largest body": self.largest, "holes filled": self.fill}
        said |= {"remeshed": self.remesh, "convex hull": self.hull, "glued": self.glued, fewer: self.simplify}
        return tuple(word for word, is_asked in said.items() if is_asked)

    def __str__(self) -> str:
        return "_".join(self.words).replace(" ", "_")


SAFE_NAME = r"\A(?!.*(?:\A|/)\.{1,2}(?:/|\Z))[^/\\\x00-\x1f]+(?:/[^/\\\x00-\x1f]+)*\Z"
"""A relative path without `.` and `..`."""


class MeshFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file that the shape of an object is made of."""

    name: Annotated[str, Meta(pattern=SAFE_NAME, max_length=200)]
    """Its path in the folder in which the shape is built."""
    sha256: Digest
    size: Count
    """Size [bytes]."""


class ShapeTask(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that the shape of an object depends on, its files by their content."""

    files: Annotated[tuple[MeshFile, ...], Meta(min_length=1, max_length=64)]
    """The mesh first, then the files with its geometry that it names."""
    scale: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None
    """Metres to a unit of the mesh; None: 1."""
    mesh: MeshPreparation | None = None
    """Changes of the mesh; None: taken as it is."""
    surface: Literal["paper", "released"] = "paper"
    """How surface points are drawn; all protocols but `released` have those of the paper."""
    surface_seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    code: Digest
    """Digest of the code that builds it, and of the versions of its packages."""

    @property
    def key(self) -> str:
        """Its name in stores and on the bus: the sha256 of all fields."""
        return hashlib.sha256(msgspec.msgpack.encode(self)).hexdigest()


PIECE_SIZE = 1 << 20  # Bytes of a blob in a message, at most
MOST_PIECES = 15  # Pieces that fit into a message


def split_payload(payload: bytes) -> tuple[bytes, ...]:
    """Return a payload deflated (zlib), in pieces as messages carry them."""
    deflated = zlib.compress(payload, 1)
    return tuple(deflated[start : start + PIECE_SIZE] for start in range(0, len(deflated), PIECE_SIZE))


class Build(Message, frozen=True, kw_only=True):
    """Coordinator to worker: a leased build, the shape of an object of a library."""

    wire_name = "build"

    epoch: Count
    batch: BatchId
    attempt: Count
    join: Count
    """The worker's join number that this lease belongs to (the join fence)."""
    task: ShapeTask


class Built(Message, frozen=True, kw_only=True):
    """Worker to coordinator: the shape of an object, or the reason why it was not built."""

    wire_name = "built"

    epoch: Count
    batch: BatchId
    attempt: Count
    wid: Wid
    key: ShownKey = b""
    pieces: Annotated[tuple[bytes, ...], Meta(max_length=MOST_PIECES)] = ()
    """The packed shape (`split_payload`); none if it was not built."""
    reason: Text = ""
    """Reason why it was not built; empty if it was."""
    is_final: bool = False
    """No worker can build it: of such files no object can be made."""
    cpu_seconds: Number = 0.0
