"""Priors: decoding of a genome's leading genes to hand poses; interface, kinds and table."""

from qdgrasp_worker.priors.aimed import AIMED, VALUED
from qdgrasp_worker.priors.base import GIVEN, SPHERICAL, Prior
from qdgrasp_worker.priors.surface_priors import ANTIPODAL, APPROACH, CONTACT

PRIORS: dict[str, Prior] = {
    prior.name: prior for prior in (AIMED, ANTIPODAL, APPROACH, CONTACT, GIVEN, SPHERICAL, VALUED)
}
