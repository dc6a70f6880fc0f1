"""Priors: what a genome is taken to mean. One module each, and the table of them."""

from qdgrasp_worker.priors.aimed import AIMED
from qdgrasp_worker.priors.antipodal import ANTIPODAL
from qdgrasp_worker.priors.approach import APPROACH
from qdgrasp_worker.priors.contact import CONTACT
from qdgrasp_worker.priors.given import GIVEN
from qdgrasp_worker.priors.prior import Drawn, Poses, Prior
from qdgrasp_worker.priors.spherical import SPHERICAL

PRIORS: dict[str, Prior] = {
    prior.name: prior for prior in (AIMED, ANTIPODAL, APPROACH, CONTACT, GIVEN, SPHERICAL)
}

__all__ = [
    "AIMED",
    "ANTIPODAL",
    "APPROACH",
    "CONTACT",
    "GIVEN",
    "PRIORS",
    "SPHERICAL",
    "Drawn",
    "Poses",
    "Prior",
]
