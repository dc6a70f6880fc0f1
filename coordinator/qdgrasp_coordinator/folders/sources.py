"""Sources: the runs that the rows of a reduced journal come from."""

from typing import Any

from msgspec import Struct

from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.spec import RunSpec, from_toml


class Source(Struct, frozen=True, kw_only=True):
    """A run of which a journal keeps the successes."""

    run: str
    """The name of the folder it lay in."""
    spec: str
    """Its full spec as TOML."""
    scene: str
    """sha256 of the scene bundle."""
    digest: str
    """The sha256 over all of its rows, before any was left out."""
    package: str
    """The version of this package that began it."""
    platform: dict[str, str]
    """What its rows were made on."""
    summary: dict[str, Any]
    """Its figures, as `info --json` prints them."""
    kept: int
    """How many of its rows are kept."""

    @property
    def asked(self) -> RunSpec:
        """Its spec."""
        return from_toml(self.spec, self.run)

    @property
    def words(self) -> str:
        """One line for a person."""
        done = counted(self.summary["evaluations"], "evaluation")
        return f"{self.run}: {self.asked.method}, seed {self.asked.seed}, {done}, {self.digest[:12]}"
