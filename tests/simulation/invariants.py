"""The invariants: what must hold after every event, whatever went wrong before it."""

from tests.simulation.searching import Violated

INVARIANTS = {
    "no machine fails": "no state machine raises what its callers do not expect",
    "no machine spins": "nobody looks up again and again with nothing heard and nothing to do",
    "settled once": "every batch is settled at most once, by a worker that was leased it, with its true rows",
    "nothing is lost": "every row that was asked and is not settled waits or is leased, in one place",
    "told in order": "the search is asked and told generation by generation, index by index, L in flight",
    "true journal": "the disk holds a beginning of the undisturbed journal",
    "recorded before forgotten": "the outbox keeps every row that is not on the disk",
    "acknowledged when durable": "no number is reported that is not on the disk",
    "epochs rise": "each turn has an epoch of its own; no rows of a lower one than the last are taken",
    "fenced": "a worker holds nothing of another epoch, or of an older join that it did not list then",
    "bounded work": "nobody is leased more than its credit, or holds more but what was taken back unheard",
    "bounded memory": "no container grows beyond its stated bound",
    "work is handed out": "no worker with credit waits while a batch does",
    "patience while cut off": "nobody is given up while the coordinator's own link is down",
    "progress": "with one worker left and nothing going wrong, rows are recorded, to the end",
}


def require(holds: bool, invariant: str, *words: object) -> None:
    """Check one thing.

    Raises
    ------
    Violated
        It does not hold.
    """
    if not holds:
        raise Violated(invariant, " ".join(map(str, words)))
