"""Priors: what a genome is taken to mean. One module each, and the table of them."""

from qdgrasp_worker.priors.approach import APPROACH
from qdgrasp_worker.priors.contact import CONTACT
from qdgrasp_worker.priors.given import GIVEN
from qdgrasp_worker.priors.prior import Poses, Prior

PRIORS: dict[str, Prior] = {prior.name: prior for prior in (APPROACH, CONTACT, GIVEN)}

__all__ = ["APPROACH", "CONTACT", "GIVEN", "PRIORS", "Poses", "Prior"]
