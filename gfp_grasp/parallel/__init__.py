"""Independent jobs over processes of this machine or of a cluster, with the same answer wherever they run."""

from gfp_grasp.parallel.jobs import Progress, pmap
from gfp_grasp.parallel.processes import ATTEMPTS, one_thread

__all__ = ["ATTEMPTS", "Progress", "one_thread", "pmap"]
