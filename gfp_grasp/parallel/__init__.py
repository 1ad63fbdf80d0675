"""Independent jobs over processes of this machine or of a cluster, with the same answer wherever they run."""

from gfp_grasp.parallel.jobs import pmap
from gfp_grasp.parallel.lost import ATTEMPTS

__all__ = ["ATTEMPTS", "pmap"]
