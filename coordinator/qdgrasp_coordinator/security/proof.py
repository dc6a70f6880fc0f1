"""The proof that an access list holds: everybody tries everything at a running router."""

from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.security import verdicts
from qdgrasp_coordinator.security.attempts import ATTEMPTS
from qdgrasp_coordinator.security.stage import ACTORS, WIDE, stage
from qdgrasp_coordinator.security.strangers import Knock, knocks
from qdgrasp_coordinator.security.verdicts import Cell
from qdgrasp_protocol.endpoint import Endpoint

PATIENCE = 10.0  # seconds that opening a session may take


@dataclass(frozen=True)
class Proof:
    """What was found.

    Attributes
    ----------
    matrix
        Every key, verb and role.
    wide
        What went over patterns that no role may use.
    knocks
        Who tried to get in without a session being theirs to have.
    """

    matrix: list[Cell]
    wide: list[str]
    knocks: list[Knock]

    @property
    def faults(self) -> list[str]:
        """All that is not as it should be, in words."""
        told = [words for cell in self.matrix for words in cell.wrong]
        over = [f"by a pattern that nobody may use: {words}" for words in self.wide]
        inside = [f"got in with {knock.who}" for knock in self.knocks if knock.got_in]
        return [*dict.fromkeys(told), *over, *inside]

    @property
    def holds(self) -> bool:
        """Everything was as it should be."""
        return not self.faults

    @property
    def words(self) -> str:
        """A summary in a sentence."""
        wrong = sum(bool(cell.wrong) for cell in self.matrix)
        permitted = sum(cell.is_allowed for cell in self.matrix)
        inside = sum(knock.got_in for knock in self.knocks)
        return (
            f"{len(self.matrix)} cells measured: {permitted} allowed, {len(self.matrix) - permitted} silent, "
            f"{wrong} wrong; {len(WIDE)} wide patterns tried by {len(ACTORS)} roles, {len(self.wide)} leaks; "
            f"{len(self.knocks)} kinds of strangers, {inside} got in."
        )


def prove(endpoint: str, folder: Path, *, takers_at: str | None = None) -> Proof:
    """Try everything at the router on `endpoint`.

    Parameters
    ----------
    endpoint
        Of the router.
    folder
        What `qdgrasp security init` wrote, with the authority's key.
    takers_at
        Of a second router, which relays with the first: those who take are its clients; None: one router.

    Raises
    ------
    EndpointError
        The router does not answer, or takes none of the roles; or several were named.
    SecurityError
        The folder lacks a file.
    """
    for place in filter(None, (endpoint, takers_at)):
        Endpoint.parse(place)
    with stage(endpoint, folder, PATIENCE, takers_at) as actors:
        seen = set().union(*(attempt(actors) for attempt in ATTEMPTS.values()))
    return Proof(verdicts.cells(seen), verdicts.wide(seen), knocks(endpoint, folder))
