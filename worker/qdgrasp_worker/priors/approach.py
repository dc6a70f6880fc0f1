"""approach: the hand looks at a surface point from near its normal: nu in [0, nu_a], nu_a = pi / 4.

Huber et al. 2024, section III-A, eq. 1; the interval of nu is the layout's.
"""

from qdgrasp_worker.priors.cone import Cone

APPROACH = Cone("approach")
