"""contact: the least of priors. The hand looks at a surface point from anywhere: nu in [0, pi].

It is approach with nu_a = pi (Huber et al. 2024, section III-A); the interval of nu is the layout's.
"""

from qdgrasp_worker.priors.cone import Cone

CONTACT = Cone("contact")
