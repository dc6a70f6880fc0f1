"""Priors: decoding of a genome's leading genes to hand poses; interface, kinds and table."""

from qdgrasp_worker.priors.base import GIVEN, SPHERICAL, Prior
from qdgrasp_worker.priors.surface_priors import ANTIPODAL, APPROACH, CONTACT
from qdgrasp_worker.priors.valued import VALUED

PRIORS: dict[str, Prior] = {
    prior.name: prior for prior in (ANTIPODAL, APPROACH, CONTACT, GIVEN, SPHERICAL, VALUED)
}
